"""What a white-box attack may know of the defence: state and algorithm, never its rng; it changes nothing."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import torch

import defenders
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Situation
from tests.cp_env.world.test_world import Curious, figures, make, perturbations, play


def rngs(seed: int, n: int = 2) -> list[np.random.Generator]:
    return np.random.default_rng(seed).spawn(n)


@pytest.mark.parametrize("defender", [name for name in defenders.names() if name != "oracle"])
def test_a_simulation_predicts_the_frame_but_for_the_rng_and_changes_nothing(bank: SceneBank, defender: str) -> None:
    expected = play(make(bank, 2, defender=defender, grace_frames=0), [1, 2])
    world = make(bank, 2, defender=defender, grace_frames=0)
    world.reset([1, 2])
    for t in range(6):
        situation = world.situation()
        situation.simulate(perturbations(world, t + 50), rngs(t))
        before = pickle.dumps(world.defenders)
        simulated = situation.simulate(perturbations(world, t), [copy.deepcopy(state.rng) for state in world._worlds])
        assert pickle.dumps(world.defenders) == before
        played = world.step(perturbations(world, t))
        for e in range(2):
            assert figures(simulated, e) == figures(played, e) == expected[e][t]
            assert simulated.judgements[e].groups == played.judgements[e].groups


def test_an_attacks_rng_is_its_own(bank: SceneBank) -> None:
    world = make(bank, 2, defender=Curious())
    world.reset([1, 2])

    def asked(seed: int) -> list[tuple[frozenset[int], ...]]:
        return [j.groups for j in world.situation().simulate(perturbations(world, 0), rngs(seed)).judgements]

    assert asked(3) == asked(3)
    assert len({str(asked(seed)) for seed in range(8)}) > 1
    assert len({str(asked(seed)[0]) for seed in range(8)}) > 1, "each world has an rng of its own"


def test_the_situation_shows_what_the_ego_did_last(bank: SceneBank) -> None:
    world = make(bank, 2, grace_frames=0)
    world.reset([1, 2])
    first: Situation = world.situation()
    assert first.output == first.verdict == (None, None)
    outcome = world.step(perturbations(world, 0))
    later = world.situation()
    for shown, played in zip(later.output, outcome.output, strict=True):  # another object over the same arrays
        assert shown is not None and shown is not played and shown.seen.boxes is played.seen.boxes
    assert later.verdict == outcome.verdicts
    assert later.place.shape == (2, 2) and not np.array_equal(later.place, first.place)
    world.reset([3], [0])
    anew, going_on = world.situation().output
    assert anew is None and going_on is not None
    assert going_on.detections.boxes is outcome.output[1].detections.boxes


def test_maps_are_read_when_they_are_asked_for_and_stay_those_of_the_frame(bank: SceneBank) -> None:
    world = make(bank, 2, grace_frames=0)
    world.reset([1, 2])
    kept = world.situation()
    expected = [one.clone() for one in (world.situation().received, world.situation().clean.logits)]
    world.step(perturbations(world, 0))
    assert not np.array_equal(world.situation().place, kept.place)
    assert torch.equal(kept.received, expected[0]) and torch.equal(kept.clean.logits, expected[1])
    assert kept.received is kept.received


def test_what_is_added_for_a_simulation_is_taken_away_again(bank: SceneBank) -> None:
    world = make(bank, 2, grace_frames=0)
    world.reset([1, 2])
    before = world.current().received.clone()
    world.situation().simulate(perturbations(world, 0), rngs(0))
    assert torch.equal(world.current().received, before)
    with pytest.raises(ValueError, match="finite"):
        world.situation().simulate(perturbations(world, 0) * torch.nan, rngs(0))
    assert torch.equal(world.current().received, before)


def test_a_failed_step_leaves_the_frame_as_it_was(bank: SceneBank, monkeypatch: pytest.MonkeyPatch) -> None:
    world = make(bank, 2, grace_frames=0)
    world.reset([1, 2])
    before = world.situation().received
    with monkeypatch.context() as patched:
        patched.setattr("cp_env.world.world.judge", lambda *args: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            world.step(perturbations(world, 0))
    assert torch.equal(world.situation().received, before)
    other = make(bank, 2, grace_frames=0)
    other.reset([1, 2])
    played, expected = world.step(perturbations(world, 1)), other.step(perturbations(other, 1))
    assert all(figures(played, e) == figures(expected, e) for e in range(2))
