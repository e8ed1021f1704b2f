"""`bayes`: exact under a binary verifier, fair in the world it is calibrated for, and robust to attacks on it."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest

from defenders import Bayes, Defender
from defenders.bayes.histograms import Calibrated, open_likelihood
from defenders.bayes.likelihood import Verifier
from defenders.simulation.world import FrameResult, Scenario, SimulatedWorld, every, turning

SURE = Verifier(1e-6, 1e-6)


def watch(
    defender: Defender, world: SimulatedWorld, frames: int, attack: bool = True, seed: int = 0
) -> list[FrameResult]:
    defender.reset(world.n_vehicles, np.random.default_rng(seed))
    return [world.judge(defender, attack) for _ in range(frames)]


@dataclass
class CalibratedWorld(SimulatedWorld):
    """Similarities drawn from the densities that the defender is calibrated with, each pair of views by itself."""

    densities: Calibrated = field(default_factory=lambda: open_likelihood("calibrated"))  # type: ignore[arg-type,return-value]
    seed: int = 0

    def view(self, group: object) -> int:
        number = super().view(group)  # type: ignore[arg-type]
        self.__dict__.setdefault("known", {})[number] = (self.frame, frozenset(group), frozenset(group) & self.active)  # type: ignore[call-overload]
        return number

    def similarity(self, a: int, b: int) -> float:
        (then, earlier, its), (now, later, attackers) = (
            self.__dict__["known"][min(a, b)],
            self.__dict__["known"][max(a, b)],
        )
        density = self.densities.uncontaminated(len(later), len(earlier), len(later & earlier), max(now - then, 1))
        if attackers and its:
            density = self.densities.both_contaminated(len(later), len(earlier))
        elif attackers:
            density = self.densities.one_contaminated(len(later), len(attackers), len(earlier))
        elif its:
            density = self.densities.one_contaminated(len(earlier), len(its), len(later))
        rng = np.random.default_rng([self.seed, a, b])
        low = rng.choice(len(density), p=density)
        return float(rng.uniform(self.densities.edges[low], self.densities.edges[low + 1]))


@pytest.mark.parametrize("n", range(2, 11))
def test_finds_exactly_the_attackers_whatever_their_number(n: int) -> None:
    """Two verifications a frame at most, and within 1.3 times n / 2 frames on average (FACTS: n bits, two a frame)."""
    taken = []
    for k in range(1, n):
        for seed in range(3 if n < 6 else 1):
            episode = Scenario(n_vehicles=n, n_attackers=k, max_frames=40).play(Bayes(likelihood="perfect"), seed)
            assert episode.converged and episode.suspects == episode.attackers
            assert episode.results[-1].verdict.collaborators <= frozenset(range(n)) - episode.attackers
            assert max(episode.verifications) <= 2
            taken.append(len(episode.results))
    assert np.mean(taken) <= 1.3 * max(n / 2, 1.6)


def test_every_set_of_attackers_of_four_vehicles_the_ego_too() -> None:
    for k in range(1, 4):
        for attackers in map(frozenset, combinations(range(4), k)):
            results = watch(Bayes(likelihood=SURE), SimulatedWorld(4, attackers, schedule=turning(1, late=k)), 8)
            assert results[-1].verdict.suspects == attackers and results[-1].verdict.converged


@pytest.mark.parametrize("k", [2, 17])
def test_particles_find_attackers_among_twenty(k: int) -> None:
    episode = Scenario(n_vehicles=20, n_attackers=k, max_frames=40).play(Bayes(likelihood="perfect", particles=512), 1)
    assert episode.converged and episode.suspects == episode.attackers
    assert len(episode.results) <= 16 and max(episode.verifications) <= 2


def test_a_thousand_clean_frames_flag_nobody_and_leave_out_nobody() -> None:
    world = CalibratedWorld(5, frozenset())
    results = watch(Bayes(), world, 1000)
    assert not any(result.verdict.suspects for result in results)
    assert np.mean([len(result.verdict.collaborators) for result in results]) > 4.9
    assert np.mean([result.verifications for result in results]) < 0.5


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_finds_attackers_in_the_world_it_is_calibrated_for(k: int) -> None:
    found, wrong, benign = 0, 0, 0
    for seed in range(10):
        attackers = frozenset(np.random.default_rng(seed).permutation(5)[:k].tolist())
        results = watch(Bayes(), CalibratedWorld(5, attackers, schedule=turning(1, late=k), seed=seed), 15)
        suspects = results[-1].verdict.suspects
        found, wrong, benign = found + len(suspects & attackers), wrong + len(suspects - attackers), benign + 5 - k
        assert max(result.verifications for result in results) <= 2
    assert found >= 0.9 * 10 * k and wrong <= 0.05 * benign + 1


# -- attacks on the defence ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_attacks_from_the_very_first_frame(k: int) -> None:
    for seed in range(3):
        attackers = frozenset(np.random.default_rng(seed).permutation(5)[:k].tolist())
        last = watch(Bayes(likelihood=SURE), SimulatedWorld(5, attackers), 14, seed=seed)[-1]
        assert last.verdict.suspects == attackers and not last.verdict.collaborators & attackers


@pytest.mark.parametrize("period", [2, 3, 5])
def test_attackers_who_pause_are_found_and_not_forgotten(period: int) -> None:
    attackers = frozenset({0, 3})
    results = watch(Bayes(likelihood=SURE), SimulatedWorld(5, attackers, schedule=every(period, start=1)), 8 * period)
    assert results[-1].verdict.suspects == attackers
    settled = next(t for t, result in enumerate(results) if result.verdict.converged)
    assert settled <= 6 * period
    assert all(result.verdict.suspects == attackers for result in results[settled:])


@pytest.mark.parametrize("k", [2, 3])
def test_a_vehicle_that_turns_after_the_others_were_found(k: int) -> None:
    for seed in range(3):
        attackers = frozenset(np.random.default_rng(seed).permutation(5)[:k].tolist())
        results = watch(Bayes(likelihood="perfect"), SimulatedWorld(5, attackers, schedule=turning(30)), 45, seed=seed)
        early = attackers - {max(attackers)}
        assert results[29].verdict.suspects == early
        assert results[-1].verdict.suspects == attackers
        assert results[29].verifications == 0 < max(r.verifications for r in results[30:])


def test_an_attack_after_two_hundred_frames_is_found_as_fast_as_ever() -> None:
    for attacker in range(5):
        results = watch(
            Bayes(likelihood=SURE), SimulatedWorld(5, frozenset({attacker}), schedule=every(1, start=200)), 204
        )
        assert not any(result.verdict.suspects or result.verifications for result in results[:200])
        assert results[-1].verdict.suspects == {attacker}


@pytest.mark.parametrize("alone", [True, False])
def test_framing_does_not_convict_the_benign_vehicle(alone: bool) -> None:
    """The attack of vehicle 0 shows only where vehicle 1 is fused too (or only where it is not): 1 is never flagged.

    The defender must know that the verifier errs. One that takes it for perfect flags vehicle 1.
    """

    def similarity_model(group: frozenset[int], active: frozenset[int], rng: np.random.Generator) -> float:
        return float(not (active and (1 in group) == alone))

    world = SimulatedWorld(5, frozenset({0}), similarity_model=similarity_model, schedule=every(1, start=1))
    results = watch(Bayes(likelihood=Verifier(0.05, 0.05)), world, 60)
    assert not any(1 in result.verdict.suspects for result in results)


def test_one_attacked_frame_convicts_no_benign_vehicle() -> None:
    """After a hundred clean frames all but one attack, once."""
    attackers = frozenset(range(4))
    world = CalibratedWorld(5, attackers, schedule=lambda t, attackers: attackers if t == 100 else frozenset())
    results = watch(Bayes(), world, 110)
    assert not any(result.verdict.suspects - attackers for result in results)
    assert not any(result.verdict.suspects for result in results[:100])


# -- behaviour -------------------------------------------------------------------------------------------------------


def test_pickling_between_frames_changes_nothing() -> None:
    for n in (5, 18):
        played = []
        for through_pickle in (False, True):
            defender: Defender = Bayes(likelihood="perfect", particles=64)
            defender.reset(n, np.random.default_rng(0))
            world, results = SimulatedWorld(n, frozenset({0, 4}), schedule=every(1, start=1)), []
            for _ in range(6):
                defender = pickle.loads(pickle.dumps(defender)) if through_pickle else defender
                results.append(world.judge(defender))
            played.append(results)
        assert played[0] == played[1]


def test_pays_nothing_while_sure() -> None:
    results = watch(Bayes(likelihood="perfect"), SimulatedWorld(5, frozenset({2}), schedule=every(1, start=1)), 60)
    assert sum(result.verifications for result in results) <= 12
    assert all(result.verdict.suspects == {2} for result in results[6:])


def test_one_vehicle_alone_is_fused() -> None:
    results = watch(Bayes(), SimulatedWorld(1, frozenset()), 5)
    assert all(result.verdict.collaborators == {0} and not result.verdict.suspects for result in results)


@pytest.mark.parametrize(
    "options",
    [
        {"certainty": 0.5},
        {"certainty": 1.0},
        {"switch_prob": 0.0},
        {"min_gain_bits": -1.0},
        {"particles": 1},
        {"exact_to": 21},
        {"max_verifications": 0},
        {"initial_attack_prob": 0.0},
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        Bayes(**options)  # type: ignore[arg-type]
