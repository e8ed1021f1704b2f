"""Attacks on the defence itself, under a perfect verifier: timed, hidden and targeted attacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from defenders import Bayes, Defender, Pasac, Prbi, Robosac, RobustPrbi
from defenders.simulation.statistics import EpisodeStats, members, play_many
from defenders.simulation.verifier import Group
from defenders.simulation.world import Episode, Scenario, every
from examples.reproduce import prbi_attacks
from examples.reproduce.prbi_attacks import FIVE, SITUATIONS

EPISODES = 12


def robust() -> Prbi:
    return RobustPrbi(rearm=True)


def played(defender: Defender, scenario: Scenario, episodes: int = EPISODES) -> EpisodeStats:
    return play_many(defender, scenario, episodes=episodes, seed=0)


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS) - {"framing", "nobody"}))
def test_robust_and_rearmed_withstands(situation: str) -> None:
    stats = played(robust(), SITUATIONS[situation])
    assert stats.converged.all() and stats.exact_identification.all()
    assert not stats.fused_attackers[:, -10:].any()


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS) - {"framing", "nobody", "out of step"}))
def test_bayes_withstands(situation: str) -> None:
    """All but "out of step": `bayes` assumes that all attackers are active or none."""
    stats = played(Bayes(likelihood="perfect"), SITUATIONS[situation], 2)
    assert stats.exact_identification.all() and not stats.fused_attackers[:, -10:].any()
    assert stats.all_verifications.max() <= 2


@pytest.mark.parametrize("defence", [Prbi, RobustPrbi])
@pytest.mark.parametrize("period", [3, 5])
def test_attacking_seldom_gains_nothing(period: int, defence: type[Prbi]) -> None:
    """Table 6: nothing is verified or counted in a normal frame, so the abnormal frames go as if they came in a row."""

    def abnormal(scenario: Scenario) -> list[object]:
        episode: Episode = scenario.play(defence(), 3)
        return [(r.verdict, r.verifications) for r in episode.results if r.active]

    steady = abnormal(replace(FIVE, max_frames=8))
    seldom = abnormal(replace(FIVE, max_frames=8 * period, schedule=every(period, start=1)))
    assert seldom == steady


@pytest.mark.parametrize("k", [1, 2, 3, 4])
@pytest.mark.parametrize("period", [1, 3, 5])
def test_attackers_on_a_schedule_are_all_found(period: int, k: int) -> None:
    for defence in (Prbi, RobustPrbi):
        scenario = replace(FIVE, n_attackers=k, schedule=every(period, start=1), max_frames=100, until_converged=True)
        stats = played(defence(), scenario, 4)
        assert stats.converged.all() and (stats.identified == 1).all()
        assert not stats.fused_attackers.any()


def test_the_paper_trusts_the_first_frame() -> None:
    """An attack in it makes a reference that no view resembles: the published algorithm never recovers."""
    stats = played(Prbi(), SITUATIONS["first frame"], 10)
    assert not stats.converged.any()
    assert (stats.fused_attackers > 0).all()


@pytest.mark.parametrize("k", [1, 2, 3])
def test_robust_recovers_from_a_poisoned_reference(k: int) -> None:
    """Two searches find nobody. From the third frame on the reference is right, if two benign views agree."""
    stats = played(robust(), replace(SITUATIONS["first frame"], n_attackers=k))
    assert stats.exact_identification.all() and not stats.fused_attackers[:, 2:].any()


def test_robust_recovers_even_if_all_but_one_attack_from_the_first_frame() -> None:
    """One benign view agrees with no other, so references are tried until one holds: 1 in 5 a frame."""
    stats = played(robust(), replace(SITUATIONS["first frame"], n_attackers=4, max_frames=100))
    assert stats.exact_identification.all()


@pytest.mark.parametrize("defence", [Prbi, RobustPrbi])
def test_a_turncoat_goes_unnoticed_without_rearm(defence: type[Prbi]) -> None:
    stats = played(defence(), SITUATIONS["turncoat"])
    assert stats.converged.all() and (stats.identified == 0.5).all()
    assert (stats.fused_attackers[:, 19:] == 1).all() and not stats.verifications[:, 19:].any()


@pytest.mark.parametrize("k", [1, 2, 3, 4])
@pytest.mark.parametrize("defence", [Prbi, RobustPrbi])
def test_a_turncoat_is_found_with_rearm(defence: type[Prbi], k: int) -> None:
    stats = played(defence(rearm=True), replace(SITUATIONS["turncoat"], n_attackers=k), 6)
    assert stats.converged.all() and (stats.identified == 1).all()
    assert not stats.fused_attackers.any(), (
        "neither the turncoat nor a vehicle convicted before is fused while it attacks"
    )


def test_all_but_one_attack() -> None:
    for n in (2, 6, 12):
        stats = played(RobustPrbi(), Scenario(n_vehicles=n, n_attackers=n - 1), 6)
        assert stats.exact_identification.all() and stats.frames.max() <= n
        assert stats.verifications.max() <= 2 * (n - 1)


@pytest.mark.parametrize("defender", [Prbi(), robust()])
def test_nobody_attacks_for_a_thousand_frames(defender: Prbi) -> None:
    stats = played(defender, SITUATIONS["nobody"], 1)
    assert stats.frames.tolist() == [1000]
    assert not stats.flagged.any() and not stats.all_verifications.any()
    assert (stats.fused == 0b11111).all()


def test_framing_is_contained() -> None:
    """The attacker of the pair cannot be identified. The published rule keeps fusing both; ours hardly ever does."""
    scenario = SITUATIONS["framing"]
    paper, ours = (prbi_attacks.fooled(played(d, scenario), scenario).sum(axis=1).mean() for d in (Prbi(), robust()))
    assert paper > 20 and ours < 2


def test_attackers_out_of_step_fool_the_published_rule() -> None:
    """A vehicle that pauses while another attacks passes, and is not suspected again: its P_benign is above zero."""
    stats = played(Prbi(), SITUATIONS["out of step"])
    assert stats.exact_identification.mean() < 0.5 and (stats.fused_attackers > 0).any()


def test_the_rows() -> None:
    row = prbi_attacks.measure(RobustPrbi(), SITUATIONS["all but one"], 5, 0)
    assert (row.convergence_rate, row.exact_identification, row.id_rate, row.mc_rate, row.fooled) == (1, 1, 1, 0, 0)
    assert row.max_verifications <= 8 and np.isfinite(row.verifications)
    nobody = prbi_attacks.measure(Prbi(), SITUATIONS["nobody"], 1, 0)
    assert nobody.id_rate is None and nobody.verifications == 0


# ROBOSAC and PASAC compare with the ego-only view, and judge every frame anew.


def knowing(k: int) -> Robosac:
    return Robosac(reading="until_success", n_attackers=k)


def trusted(situation: str) -> Scenario:
    """The situation with a benign ego, as both assume."""
    scenario = SITUATIONS[situation]
    return replace(scenario, benign={0}, max_frames=min(scenario.max_frames, 100))


@pytest.mark.parametrize("situation", sorted(SITUATIONS))
def test_a_benign_ego_never_fuses_an_active_attacker(situation: str) -> None:
    """Whenever and in whatever number the others attack: neither defender carries anything from frame to frame."""
    scenario = trusted(situation)
    for defender in (Pasac(), Robosac(), knowing(scenario.n_attackers)):
        stats = played(defender, scenario, 3)
        assert not stats.fused_attackers.any(), type(defender).__name__
        assert not stats.converged.any(), "there is nothing to converge: each frame is paid for"


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS)))
def test_pasac_flags_the_active_attackers_of_the_frame(situation: str) -> None:
    """The turncoat at once, attackers that come and go while they are present, and no attacker that pauses."""
    stats = played(Pasac(), trusted(situation), 3)
    assert (stats.flagged == stats.active).all()


def test_robosac_that_knows_k_finds_the_turncoat_at_once_and_flags_too_many_before() -> None:
    """It leaves out k vehicles, of which one is benign until frame 20 (the first frame is not recorded)."""
    stats = played(knowing(2), trusted("turncoat"))
    before, after = (stats.flagged[:, :19], stats.active[:, :19]), (stats.flagged[:, 19:], stats.active[:, 19:])
    assert (after[0] == after[1]).all()
    assert (before[0] & before[1] == before[1]).all() and (before[0] != before[1]).all()


@pytest.mark.parametrize("situation", ["every 3", "every 5", "out of step"])
def test_robosac_that_knows_k_flags_benign_vehicles_while_attackers_pause(situation: str) -> None:
    stats = played(knowing(2), trusted(situation))
    at_work = members(stats.active, 5).sum(axis=2) == 2
    assert (stats.flagged == stats.active)[at_work].all()
    assert (members(stats.flagged & ~stats.attackers[:, None], 5).any(axis=2))[~at_work].any()


def test_robosac_searches_in_vain_while_a_benign_vehicle_is_away() -> None:
    """Two of three others attack, and teams of n - k = 2 are drawn: the ego stays alone, at 1,000 verifications."""
    stats = played(knowing(2), trusted("drops out"), 1)
    away = (np.arange(1, 41) >= 2) & (np.arange(1, 41) < 22)
    assert (stats.verifications[0, away] == 1000).all() and (stats.fused[0, away] == 1).all()
    assert stats.verifications[0, ~away].max() < 200


def test_all_but_the_ego_attack() -> None:
    """ROBOSAC with known k has nobody to draw and pays nothing. PASAC verifies its whole tree below the root."""
    scenario = trusted("all but one")
    for defender, verifications in ((knowing(4), 0), (Robosac(), 5), (Pasac(), 6)):
        stats = played(defender, scenario, 2)
        assert (stats.all_verifications == verifications).all() and (stats.fused == 1).all()


@pytest.mark.parametrize(("defender", "verifications"), [(Pasac(), 2), (Robosac(), 1), (knowing(0), 1)])
def test_every_frame_is_paid_for_without_an_attack(defender: Defender, verifications: int) -> None:
    stats = played(defender, SITUATIONS["nobody"], 1)
    assert stats.frames.tolist() == [1000] and (stats.all_verifications == verifications).all()
    assert not stats.flagged.any() and (stats.fused == 0b11111).all()


@pytest.mark.parametrize("n_attackers", [1, 2, 3])
def test_a_malicious_ego_is_trusted(n_attackers: int) -> None:
    """Its own view is the reference, which no benign view resembles. It acts on it, and PASAC flags all benign."""
    scenario = replace(FIVE, n_attackers=n_attackers, benign={4, 3, 2, 1} - set(range(1, n_attackers)))
    for defender in (knowing(n_attackers), Robosac(), Pasac()):
        stats = played(defender, replace(scenario, max_frames=2), 2)
        assert (stats.fused == 1).all() and (stats.fused_attackers == 1).all()
        if isinstance(defender, Pasac):
            assert (stats.false_accusation_rate == 1).all()


def louder(group: Group, active: Group, rng: np.random.Generator) -> float:
    """The ego's perturbation dominates: a view of any group with the ego is like the ego's own."""
    return float(not active or 0 in active)


def test_a_team_that_resembles_a_malicious_ego_is_accepted() -> None:
    """The first team drawn is accepted, with attackers or without. Flagged are the vehicles left out, though benign."""
    scenario = replace(FIVE, benign={2, 3, 4}, similarity_model=louder, max_frames=5)  # 0 and 1 attack
    robosac, pasac = (played(defender, scenario) for defender in (knowing(2), Pasac()))
    assert (robosac.all_verifications == 1).all() and (pasac.all_verifications == 2).all()
    assert (robosac.fused_attackers >= 1).all() and (robosac.fused_attackers == 2).any()
    assert members(robosac.flagged & ~robosac.attackers[:, None], 5).any(axis=2).all()
    assert (pasac.fused == 0b11111).all() and not pasac.flagged.any()
