"""Nothing that is handed out can change the world: every array is read-only, every tensor a copy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import torch

from cp_env.types import Detections, View
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome, Situation
from cp_env.world.world import World
from defenders import Defender, Frame, Inspection, Query, Verdict


def arrays(thing: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every array and tensor that can be reached from a thing by attributes and items."""
    if isinstance(thing, np.ndarray | torch.Tensor):
        yield name, thing
    elif is_dataclass(thing) and not isinstance(thing, type):
        if isinstance(thing, Situation):  # what it reads on demand
            yield from arrays(thing.received, f"{name}.received")
            yield from arrays(thing.clean, f"{name}.clean")
        for one in fields(thing):
            yield from arrays(getattr(thing, one.name), f"{name}.{one.name}")
    elif isinstance(thing, tuple | list):
        for i, one in enumerate(thing):
            yield from arrays(one, f"{name}[{i}]")


class Keeper(Defender):
    """Keeps all it is shown."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.kept = n_vehicles, []  # type: ignore[var-annotated]

    def inspect(self, frame: Frame) -> Inspection:
        (alone, pair) = yield Query([{0}, {0, 1}])  # the second becomes the output
        self.kept += [frame.seen, alone, pair]
        return Verdict({0, 1})


@pytest.fixture
def world(bank: SceneBank) -> World:
    world = World(2, defender=Keeper(), bank=bank, attackers=(1, 3), grace_frames=1, max_frames=3)
    world.reset([0, 1])
    return world


def delta(world: World) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.rand((2, 2, *world.current().received.shape[2:]), generator=generator)


def test_every_array_of_views_and_outcomes_refuses_to_be_written(world: World) -> None:
    outcome = world.step(delta(world))
    simulated = world.situation().simulate(delta(world), [np.random.default_rng(e) for e in range(2)])
    kept = [view for defender in world.defenders for view in defender.kept]  # type: ignore[attr-defined]
    found = [*arrays(outcome, "outcome"), *arrays(simulated, "simulated"), *arrays(kept, "kept")]
    assert len(found) > 60 and {name.split(".")[-1] for name, _ in found} >= {"boxes", "scores", "score_map", "origin"}
    for name, array in found:
        assert isinstance(array, np.ndarray) and not array.flags.writeable, name
        if array.size:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
            with pytest.raises(ValueError, match="cannot set WRITEABLE"):
                array.flags.writeable = True


def test_a_simulation_does_not_hold_the_truth(world: World) -> None:
    simulated = world.situation().simulate(delta(world), [np.random.default_rng(e) for e in range(2)])
    assert not isinstance(simulated, Outcome) and not hasattr(simulated, "truth")


def vandalise(situation: Any) -> None:
    """Overwrite all that can be written, through tensors and through the arrays below them."""
    for _, thing in arrays(situation):
        if isinstance(thing, torch.Tensor):
            thing.detach().numpy()[...] = 1
            with torch.no_grad():
                thing.zero_()
        elif thing.flags.writeable:
            thing[...] = 7
    for name in ("output", "verdict"):
        replace_fields(getattr(situation, name))
    simulated = situation.simulate(torch.zeros(situation.attackers.shape + situation.received.shape[2:]), rngs())
    replace_fields(simulated.clean)
    for name in ("budget", "norm", "output", "verdict"):
        object.__setattr__(situation, name, None)


def rngs() -> list[np.random.Generator]:
    return [np.random.default_rng(e) for e in range(2)]


def replace_fields(things: Any) -> None:
    """Put something else into every field of frozen views and verdicts, by the way that freezing leaves open."""
    for thing in things:
        if isinstance(thing, View):
            for found in (one for one in (thing.detections, thing.seen) if isinstance(one, Detections)):
                object.__setattr__(found, "boxes", np.zeros((0, 5)))
                object.__setattr__(found, "scores", np.zeros(0))
        if thing is not None:
            for one in fields(thing):
                object.__setattr__(thing, one.name, frozenset())


class Vandal(Keeper):
    """Replaces all that it was shown: at once, while it ends, and when it is asked for its belief."""

    def inspect(self, frame: Frame) -> Inspection:
        try:
            verdict = yield from super().inspect(frame)
            shown = [frame.seen, *self.kept, *vars(frame).values()]
            replace_fields([view for view in shown if isinstance(view, View)])
            vars(frame)["_memo"].clear()
            return verdict
        finally:
            replace_fields(self.kept)

    def belief(self) -> np.ndarray:
        replace_fields(self.kept)
        return np.zeros(5)


def test_a_defender_that_replaces_what_it_was_shown_changes_nothing(bank: SceneBank) -> None:
    def episode(defender: Defender) -> list[Outcome]:
        world = World(2, defender=defender, bank=bank, attackers=(1, 3), grace_frames=1, max_frames=3)
        world.reset([0, 1])
        outcomes = []
        for _ in range(3):
            outcomes.append(world.step(delta(world)))
            for one in world.defenders:
                one.belief()
        return outcomes

    for expected, found in zip(episode(Quiet()), episode(Vandal()), strict=True):
        assert expected.errors == found.errors == (None, None)
        assert [j.verdict for j in expected.judgements] == [j.verdict for j in found.judgements]
        for (name, one), (_, other) in zip(arrays(expected), arrays(found), strict=True):
            if name != ".seconds":
                np.testing.assert_array_equal(one, other, err_msg=name)


class Quiet(Keeper):
    """The same, without the vandalism."""

    def belief(self) -> np.ndarray:
        return np.zeros(5)


def test_an_attack_that_overwrites_its_situation_changes_nothing(bank: SceneBank) -> None:
    """Two worlds of the same seeds: in one the attack overwrites all it was handed, in every frame."""

    def episode(attack: Callable[[Any], None]) -> list[Outcome]:
        world = World(2, defender=Keeper(), bank=bank, attackers=(1, 3), grace_frames=1, max_frames=3)
        world.reset([0, 1])
        outcomes = []
        for _ in range(3):
            attack(world.situation())
            outcomes.append(world.step(delta(world)))
        return outcomes

    for honoured, vandalised in zip(episode(lambda _: None), episode(vandalise), strict=True):
        for (name, one), (_, other) in zip(arrays(honoured), arrays(vandalised), strict=True):
            if name != ".seconds":
                np.testing.assert_array_equal(one, other, err_msg=name)
