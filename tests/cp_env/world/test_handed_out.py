"""Nothing that is handed out can change the world: every array is read-only, every tensor a copy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import torch

from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from defenders import Defender, Frame, Inspection, Query, Verdict


def arrays(thing: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every array and tensor that can be reached from a thing by attributes and items."""
    if isinstance(thing, np.ndarray | torch.Tensor):
        yield name, thing
    elif is_dataclass(thing) and not isinstance(thing, type):
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
        (alone, pair) = yield Query([{0}, {1, 2}])
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
    for name in ("budget", "norm", "output", "verdict"):
        object.__setattr__(situation, name, None)


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
