"""`bayes`: exact in a yes/no world, fair in the world it is calibrated for, and hard to lead astray."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest

from defenders import Bayes, Defender
from defenders.bayes.histograms import Calibrated, open_likelihood
from defenders.bayes.likelihood import Verifier
from defenders.simulation.world import PerfectWorld, Ruling, Terms, every, turning

SURE = Verifier(1e-6, 1e-6)


def watch(defender: Defender, world: PerfectWorld, frames: int, lying: bool = True, seed: int = 0) -> list[Ruling]:
    defender.reset(world.n_vehicles, np.random.default_rng(seed))
    return [world.judge(defender, lying) for _ in range(frames)]


@dataclass
class CalibratedWorld(PerfectWorld):
    """Similarities drawn from the densities that the defender is calibrated with, each pair of views by itself."""

    densities: Calibrated = field(default_factory=lambda: open_likelihood("calibrated"))  # type: ignore[arg-type,return-value]
    seed: int = 0

    def look(self, group: object) -> int:
        number = super().look(group)  # type: ignore[arg-type]
        self.__dict__.setdefault("known", {})[number] = (self.frame, frozenset(group), frozenset(group) & self.lying)  # type: ignore[call-overload]
        return number

    def similarity(self, a: int, b: int) -> float:
        (then, earlier, its), (now, later, liars) = (
            self.__dict__["known"][min(a, b)],
            self.__dict__["known"][max(a, b)],
        )
        density = self.densities.clean(len(later), len(earlier), len(later & earlier), max(now - then, 1))
        if liars and its:
            density = self.densities.both(len(later), len(earlier))
        elif liars:
            density = self.densities.dirty(len(later), len(liars), len(earlier))
        elif its:
            density = self.densities.dirty(len(earlier), len(its), len(later))
        rng = np.random.default_rng([self.seed, a, b])
        low = rng.choice(len(density), p=density)
        return float(rng.uniform(self.densities.edges[low], self.densities.edges[low + 1]))


@pytest.mark.parametrize("n", range(2, 11))
def test_finds_exactly_the_liars_whatever_their_number(n: int) -> None:
    """Two verifications a frame at most, and within 1.3 times n / 2 frames on average (FACTS: n bits, two a frame)."""
    taken = []
    for k in range(1, n):
        for seed in range(3 if n < 6 else 1):
            episode = Terms(n_vehicles=n, n_liars=k, max_frames=40).play(Bayes(likelihood="perfect"), seed)
            assert episode.converged and episode.suspects == episode.liars
            assert episode.rulings[-1].verdict.collaborators <= frozenset(range(n)) - episode.liars
            assert max(episode.verifications) <= 2
            taken.append(len(episode.rulings))
    assert np.mean(taken) <= 1.3 * max(n / 2, 1.6)


def test_every_set_of_liars_of_four_vehicles_the_ego_too() -> None:
    for k in range(1, 4):
        for liars in map(frozenset, combinations(range(4), k)):
            rulings = watch(Bayes(likelihood=SURE), PerfectWorld(4, liars, schedule=turning(1, late=k)), 8)
            assert rulings[-1].verdict.suspects == liars and rulings[-1].verdict.converged


@pytest.mark.parametrize("k", [2, 17])
def test_particles_find_liars_among_twenty(k: int) -> None:
    episode = Terms(n_vehicles=20, n_liars=k, max_frames=40).play(Bayes(likelihood="perfect", particles=512), 1)
    assert episode.converged and episode.suspects == episode.liars
    assert len(episode.rulings) <= 16 and max(episode.verifications) <= 2


def test_a_thousand_clean_frames_accuse_nobody_and_hide_nobody() -> None:
    world = CalibratedWorld(5, frozenset())
    rulings = watch(Bayes(), world, 1000)
    assert not any(ruling.verdict.suspects for ruling in rulings)
    assert np.mean([len(ruling.verdict.collaborators) for ruling in rulings]) > 4.9
    assert np.mean([ruling.verifications for ruling in rulings]) < 0.5


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_finds_liars_in_the_world_it_is_calibrated_for(k: int) -> None:
    found, accused, innocent = 0, 0, 0
    for seed in range(10):
        liars = frozenset(np.random.default_rng(seed).permutation(5)[:k].tolist())
        rulings = watch(Bayes(), CalibratedWorld(5, liars, schedule=turning(1, late=k), seed=seed), 15)
        suspects = rulings[-1].verdict.suspects
        found, accused, innocent = found + len(suspects & liars), accused + len(suspects - liars), innocent + 5 - k
        assert max(ruling.verifications for ruling in rulings) <= 2
    assert found >= 0.9 * 10 * k and accused <= 0.05 * innocent + 1


# -- attacks on the defence ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [1, 2, 3, 4])
def test_lies_from_the_very_first_frame(k: int) -> None:
    for seed in range(3):
        liars = frozenset(np.random.default_rng(seed).permutation(5)[:k].tolist())
        last = watch(Bayes(likelihood=SURE), PerfectWorld(5, liars), 14, seed=seed)[-1]
        assert last.verdict.suspects == liars and not last.verdict.collaborators & liars


@pytest.mark.parametrize("period", [2, 3, 5])
def test_liars_who_pause_are_found_and_not_forgotten(period: int) -> None:
    liars = frozenset({0, 3})
    rulings = watch(Bayes(likelihood=SURE), PerfectWorld(5, liars, schedule=every(period, start=1)), 8 * period)
    assert rulings[-1].verdict.suspects == liars
    settled = next(t for t, ruling in enumerate(rulings) if ruling.verdict.converged)
    assert settled <= 6 * period
    assert all(ruling.verdict.suspects == liars for ruling in rulings[settled:])


@pytest.mark.parametrize("k", [2, 3])
def test_a_vehicle_that_turns_after_the_others_were_found(k: int) -> None:
    for seed in range(3):
        liars = frozenset(np.random.default_rng(seed).permutation(5)[:k].tolist())
        rulings = watch(Bayes(likelihood="perfect"), PerfectWorld(5, liars, schedule=turning(30)), 45, seed=seed)
        early = liars - {max(liars)}
        assert rulings[29].verdict.suspects == early
        assert rulings[-1].verdict.suspects == liars
        assert rulings[29].verifications == 0 < max(r.verifications for r in rulings[30:])


def test_a_vehicle_that_turns_after_a_long_peace_is_found_as_fast_as_ever() -> None:
    for liar in range(5):
        rulings = watch(Bayes(likelihood=SURE), PerfectWorld(5, frozenset({liar}), schedule=every(1, start=200)), 204)
        assert not any(ruling.verdict.suspects or ruling.verifications for ruling in rulings[:200])
        assert rulings[-1].verdict.suspects == {liar}


@pytest.mark.parametrize("alone", [True, False])
def test_framing_does_not_convict_the_innocent(alone: bool) -> None:
    """The lie of vehicle 0 shows only where vehicle 1 is fused too (or only where it is not): 1 is never accused.

    By one who knows that a verifier errs: whoever takes it for perfect is led astray.
    """

    def likeness(group: frozenset[int], lying: frozenset[int], rng: np.random.Generator) -> float:
        return float(not (lying and (1 in group) == alone))

    world = PerfectWorld(5, frozenset({0}), likeness=likeness, schedule=every(1, start=1))
    rulings = watch(Bayes(likelihood=Verifier(0.05, 0.05)), world, 60)
    assert not any(1 in ruling.verdict.suspects for ruling in rulings)


def test_one_odd_frame_convicts_no_innocent() -> None:
    """After a hundred clean frames all but one lie, once."""
    liars = frozenset(range(4))
    world = CalibratedWorld(5, liars, schedule=lambda t, who: who if t == 100 else frozenset())
    rulings = watch(Bayes(), world, 110)
    assert not any(ruling.verdict.suspects - liars for ruling in rulings)
    assert not any(ruling.verdict.suspects for ruling in rulings[:100])


# -- manners -------------------------------------------------------------------------------------------------------


def test_pickling_between_frames_changes_nothing() -> None:
    for n in (5, 18):
        played = []
        for through_pickle in (False, True):
            defender: Defender = Bayes(likelihood="perfect", particles=64)
            defender.reset(n, np.random.default_rng(0))
            world, rulings = PerfectWorld(n, frozenset({0, 4}), schedule=every(1, start=1)), []
            for _ in range(6):
                defender = pickle.loads(pickle.dumps(defender)) if through_pickle else defender
                rulings.append(world.judge(defender))
            played.append(rulings)
        assert played[0] == played[1]


def test_pays_nothing_while_sure() -> None:
    rulings = watch(Bayes(likelihood="perfect"), PerfectWorld(5, frozenset({2}), schedule=every(1, start=1)), 60)
    assert sum(ruling.verifications for ruling in rulings) <= 12
    assert all(ruling.verdict.suspects == {2} for ruling in rulings[6:])


def test_one_vehicle_has_nobody_to_doubt() -> None:
    rulings = watch(Bayes(), PerfectWorld(1, frozenset()), 5)
    assert all(ruling.verdict.collaborators == {0} and not ruling.verdict.suspects for ruling in rulings)


@pytest.mark.parametrize(
    "knobs",
    [
        {"certainty": 0.5},
        {"certainty": 1.0},
        {"turn": 0.0},
        {"worthwhile": -1.0},
        {"particles": 1},
        {"exact_to": 21},
        {"looks": 0},
        {"first": 0.0},
    ],
)
def test_knobs_out_of_range_are_refused(knobs: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(knobs))):
        Bayes(**knobs)  # type: ignore[arg-type]
