"""Attacks on the defence itself, under a verifier that sees every lie: lies timed, hidden and placed to hurt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from defenders import Bayes, Defender, Pasac, Prbi, Robosac
from defenders.simulation.statistics import Tally, members, play_many
from defenders.simulation.verifier import Group
from defenders.simulation.world import Episode, Terms, every
from examples.reproduce import prbi_attacks
from examples.reproduce.prbi_attacks import FIVE, SITUATIONS

EPISODES = 12


def robust() -> Prbi:
    return Prbi(stopping="robust", rearm=True)


def played(defender: Defender, terms: Terms, episodes: int = EPISODES) -> Tally:
    return play_many(defender, terms, episodes=episodes, seed=0)


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS) - {"framing", "nobody"}))
def test_robust_and_rearmed_withstands(situation: str) -> None:
    tally = played(robust(), SITUATIONS[situation])
    assert tally.converged.all() and tally.solved.all()
    assert not tally.deceived[:, -10:].any()


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS) - {"framing", "nobody", "out of step"}))
def test_bayes_withstands(situation: str) -> None:
    """Not liars out of step, since it takes all liars to be at work or none."""
    tally = played(Bayes(likelihood="perfect"), SITUATIONS[situation], 2)
    assert tally.solved.all() and not tally.deceived[:, -10:].any()
    assert tally.all_verifications.max() <= 2


@pytest.mark.parametrize("stopping", ["paper", "robust"])
@pytest.mark.parametrize("period", [3, 5])
def test_lying_seldom_buys_nothing(period: int, stopping: str) -> None:
    """Table 6: nothing is verified or counted in a normal frame, so the abnormal ones go as if they came in a row."""

    def abnormal(terms: Terms) -> list[object]:
        episode: Episode = terms.play(Prbi(stopping=stopping), 3)
        return [(r.verdict, r.verifications) for r in episode.rulings if r.lying]

    steady = abnormal(replace(FIVE, max_frames=8))
    seldom = abnormal(replace(FIVE, max_frames=8 * period, schedule=every(period, start=1)))
    assert seldom == steady


@pytest.mark.parametrize("k", [1, 2, 3, 4])
@pytest.mark.parametrize("period", [1, 3, 5])
def test_liars_on_a_schedule_are_all_found(period: int, k: int) -> None:
    for stopping in ("paper", "robust"):
        terms = replace(FIVE, n_liars=k, schedule=every(period, start=1), max_frames=100, until_converged=True)
        tally = played(Prbi(stopping=stopping), terms, 4)
        assert tally.converged.all() and (tally.identified == 1).all()
        assert not tally.deceived.any()


def test_the_paper_trusts_the_first_frame() -> None:
    """A lie in it is a reference that nothing resembles: the published algorithm never recovers."""
    tally = played(Prbi(), SITUATIONS["first frame"], 10)
    assert not tally.converged.any()
    assert (tally.deceived > 0).all()


@pytest.mark.parametrize("k", [1, 2, 3])
def test_robust_recovers_from_a_poisoned_reference(k: int) -> None:
    """Two searches that find nobody; from the third frame on the reference is right, if two honest views agree."""
    tally = played(robust(), replace(SITUATIONS["first frame"], n_liars=k))
    assert tally.solved.all() and not tally.deceived[:, 2:].any()


def test_robust_recovers_even_if_all_but_one_lie_from_the_first_frame() -> None:
    """One honest view has nobody to agree with, so references are tried until one holds: at 1 in 5 a frame."""
    tally = played(robust(), replace(SITUATIONS["first frame"], n_liars=4, max_frames=100))
    assert tally.solved.all()


@pytest.mark.parametrize("stopping", ["paper", "robust"])
def test_a_turncoat_goes_unnoticed_without_rearm(stopping: str) -> None:
    tally = played(Prbi(stopping=stopping), SITUATIONS["turncoat"])
    assert tally.converged.all() and (tally.identified == 0.5).all()
    assert (tally.deceived[:, 19:] == 1).all() and not tally.verifications[:, 19:].any()


@pytest.mark.parametrize("k", [1, 2, 3, 4])
@pytest.mark.parametrize("stopping", ["paper", "robust"])
def test_a_turncoat_is_found_with_rearm(stopping: str, k: int) -> None:
    tally = played(Prbi(stopping=stopping, rearm=True), replace(SITUATIONS["turncoat"], n_liars=k), 6)
    assert tally.converged.all() and (tally.identified == 1).all()
    assert not tally.deceived.any(), "neither the turncoat nor who was convicted before is ever fused while lying"


def test_all_but_one_lie() -> None:
    for n in (2, 6, 12):
        tally = played(Prbi(stopping="robust"), Terms(n_vehicles=n, n_liars=n - 1), 6)
        assert tally.solved.all() and tally.frames.max() <= n
        assert tally.verifications.max() <= 2 * (n - 1)


@pytest.mark.parametrize("knobs", [{}, {"stopping": "robust", "rearm": True}])
def test_nobody_lies_for_a_thousand_frames(knobs: dict[str, object]) -> None:
    tally = played(Prbi(**knobs), SITUATIONS["nobody"], 1)  # type: ignore[arg-type]
    assert tally.frames.tolist() == [1000]
    assert not tally.accused.any() and not tally.all_verifications.any()
    assert (tally.fused == 0b11111).all()


def test_framing_is_contained() -> None:
    """Who of the pair lies cannot be known. The published rule goes on fusing both; ours hardly ever does."""
    terms = SITUATIONS["framing"]
    paper, ours = (prbi_attacks.fooled(played(d, terms), terms).sum(axis=1).mean() for d in (Prbi(), robust()))
    assert paper > 20 and ours < 2


def test_liars_out_of_step_fool_the_published_rule() -> None:
    """Who is honest while another lies passes, and is never suspected again, as its probability is above zero."""
    tally = played(Prbi(), SITUATIONS["out of step"])
    assert tally.solved.mean() < 0.5 and (tally.deceived > 0).any()


def test_the_rows() -> None:
    row = prbi_attacks.measure(Prbi(stopping="robust"), SITUATIONS["all but one"], 5, 0)
    assert (row.sure, row.right, row.ID, row.MC, row.fooled) == (1, 1, 1, 0, 0)
    assert row.most <= 8 and np.isfinite(row.looks)
    nobody = prbi_attacks.measure(Prbi(), SITUATIONS["nobody"], 1, 0)
    assert nobody.ID is None and nobody.looks == 0


# ROBOSAC and PASAC: they compare with what the ego sees alone, and judge every frame anew.


def knowing(k: int) -> Robosac:
    return Robosac(reading="until_success", n_attackers=k)


def trusted(situation: str) -> Terms:
    """With an ego that is honest, as both assume."""
    terms = SITUATIONS[situation]
    return replace(terms, honest={0}, max_frames=min(terms.max_frames, 100))


@pytest.mark.parametrize("situation", sorted(SITUATIONS))
def test_an_honest_ego_never_fuses_a_lie(situation: str) -> None:
    """Whenever and in whatever number the others lie: a frame says nothing about the next to either."""
    terms = trusted(situation)
    for defender in (Pasac(), Robosac(), knowing(terms.n_liars)):
        tally = played(defender, terms, 3)
        assert not tally.deceived.any(), type(defender).__name__
        assert not tally.converged.any(), "there is nothing to converge: each frame is paid for"


@pytest.mark.parametrize("situation", sorted(set(SITUATIONS)))
def test_pasac_accuses_who_lies_in_this_very_frame(situation: str) -> None:
    """The turncoat at once, those who come and go while they are there, and nobody who pauses: it forgets them."""
    tally = played(Pasac(), trusted(situation), 3)
    assert (tally.accused == tally.lying).all()


def test_robosac_that_knows_k_finds_the_turncoat_at_once_and_accuses_too_many_before() -> None:
    """It leaves out as many as it was told lie, of whom one was honest until frame 20 (the first is not recorded)."""
    tally = played(knowing(2), trusted("turncoat"))
    before, after = (tally.accused[:, :19], tally.lying[:, :19]), (tally.accused[:, 19:], tally.lying[:, 19:])
    assert (after[0] == after[1]).all()
    assert (before[0] & before[1] == before[1]).all() and (before[0] != before[1]).all()


@pytest.mark.parametrize("situation", ["every 3", "every 5", "out of step"])
def test_robosac_that_knows_k_accuses_innocents_while_liars_pause(situation: str) -> None:
    tally = played(knowing(2), trusted(situation))
    at_work = members(tally.lying, 5).sum(axis=2) == 2
    assert (tally.accused == tally.lying)[at_work].all()
    assert (members(tally.accused & ~tally.liars[:, None], 5).any(axis=2))[~at_work].any()


def test_robosac_searches_in_vain_while_an_honest_vehicle_is_away() -> None:
    """Of three others two lie, and teams of n - k = 2 are drawn of them: the ego stays alone, at a thousand looks."""
    tally = played(knowing(2), trusted("drops out"), 1)
    away = (np.arange(1, 41) >= 2) & (np.arange(1, 41) < 22)
    assert (tally.verifications[0, away] == 1000).all() and (tally.fused[0, away] == 1).all()
    assert tally.verifications[0, ~away].max() < 200


def test_all_but_the_ego_lie() -> None:
    """Told so, ROBOSAC has nobody to draw and pays nothing; PASAC looks at its whole tree below the root."""
    terms = trusted("all but one")
    for defender, looks in ((knowing(4), 0), (Robosac(), 5), (Pasac(), 6)):
        tally = played(defender, terms, 2)
        assert (tally.all_verifications == looks).all() and (tally.fused == 1).all()


@pytest.mark.parametrize(("defender", "looks"), [(Pasac(), 2), (Robosac(), 1), (knowing(0), 1)])
def test_peace_is_paid_for_in_every_frame(defender: Defender, looks: int) -> None:
    tally = played(defender, SITUATIONS["nobody"], 1)
    assert tally.frames.tolist() == [1000] and (tally.all_verifications == looks).all()
    assert not tally.accused.any() and (tally.fused == 0b11111).all()


@pytest.mark.parametrize("n_liars", [1, 2, 3])
def test_a_lying_ego_is_believed(n_liars: int) -> None:
    """Its own view is the reference, so nobody honest resembles it: it acts on its lie, and PASAC accuses them all."""
    terms = replace(FIVE, n_liars=n_liars, honest={4, 3, 2, 1} - set(range(1, n_liars)))
    for defender in (knowing(n_liars), Robosac(), Pasac()):
        tally = played(defender, replace(terms, max_frames=2), 2)
        assert (tally.fused == 1).all() and (tally.deceived == 1).all()
        if isinstance(defender, Pasac):
            assert (tally.wronged == 1).all()


def louder(group: Group, lying: Group, rng: np.random.Generator) -> float:
    """The ego's lie drowns the others' maps: whoever is fused with it, the view is as the ego's own."""
    return float(not lying or 0 in lying)


def test_a_team_that_resembles_the_ego_s_lie_is_accepted() -> None:
    """The first one drawn, liars in it or not; accused are those left out, be they ever so honest."""
    terms = replace(FIVE, honest={2, 3, 4}, likeness=louder, max_frames=5)  # 0 and 1 lie
    robosac, pasac = (played(defender, terms) for defender in (knowing(2), Pasac()))
    assert (robosac.all_verifications == 1).all() and (pasac.all_verifications == 2).all()
    assert (robosac.deceived >= 1).all() and (robosac.deceived == 2).any()
    assert members(robosac.accused & ~robosac.liars[:, None], 5).any(axis=2).all()
    assert (pasac.fused == 0b11111).all() and not pasac.accused.any()
