"""Conformance rules for attacks: one for each promise of `cp_env.attack.Attack`.

    from cp_env.testing import check_attack
    check_attack(MyAttack)

An attack is checked through its two methods alone, on a crossing of four vehicles that drive on, under PRBI.
"""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cp_env import lidar
from cp_env.detector.registry import open_detector
from cp_env.perturbation.channel import norm_of
from cp_env.testing.detector import crossing
from cp_env.testing.rollout import Violation, require
from cp_env.types import Scene, Sweep
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World

FRAMES = 3
"""Frames that a rule plays; the first is one of grace."""

ROUNDING = 1e-5
"""Share of the budget by which a perturbation may be too large."""


class Driving:
    """The crossing, its vehicles under way, as a `SceneSource` of two scenes: each has another ego."""

    name = "crossing"

    def __init__(self, n_frames: int) -> None:
        self._n_frames = n_frames
        self.digest = f"crossing-{n_frames}-{lidar.DIGEST}"

    def names(self) -> tuple[str, ...]:
        return ("crossing-0", "crossing-1")

    def load(self, name: str) -> Scene:
        still = crossing()
        heading = still.pose[0, :, 2]
        metres = 0.8 * np.arange(self._n_frames)[:, None]  # 4 m/s
        way = metres[..., None] * np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
        connected = np.roll(still.connected, self.names().index(name))
        return replace(still, name=name, pose=still.pose + way, connected=connected)

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        return lidar.scan([(scene, frame) for frame in frames])


@dataclass(eq=False)
class Trial:
    """An attack and what it is tried on."""

    make: Callable[[], Any]
    bank: SceneBank
    tolerance: float

    def world(self, n_worlds: int = 2, first: int = 0, **options: Any) -> World:
        """Worlds `first`, `first + 1`, …: each depends on its own number alone."""
        given = {"n_vehicles": 4, "n_attackers": 2, "max_frames": FRAMES, **options}
        world = World(n_worlds, defender="prbi", bank=self.bank, **given)
        world.reset(list(range(first, first + n_worlds)))
        return world

    def play(self, attack: Any, world: World, first: int = 0) -> list[Tensor]:
        """Reset the attack for a world and play it; δ of every frame, a copy."""
        attack.reset(world.num_envs, generators(world.num_envs, first))
        deltas = []
        for _ in range(FRAMES):
            delta = attack.act(world.situation())
            deltas.append(delta.detach().clone() if isinstance(delta, Tensor) else delta)
            world.step(torch.as_tensor(delta).detach())
        return deltas

    @cached_property
    def deltas(self) -> list[Tensor]:
        """What a fresh attack sends in two worlds."""
        return self.play(self.make(), self.world())

    def is_close(self, a: Tensor, b: Tensor) -> bool:
        """Equal but for a hundredth of the entries: a rounding turns the sign of a gradient that is all but zero."""
        return a.shape == b.shape and float(((a - b).abs() > self.tolerance).float().mean()) <= 0.01


AttackRule = Callable[[Trial], None]


def generators(n_worlds: int, first: int = 0) -> list[np.random.Generator]:
    """Those of worlds `first`, `first + 1`, …"""
    return [np.random.default_rng([7, first + e]) for e in range(n_worlds)]


def has_the_methods(trial: Trial) -> None:
    """It has the methods `reset(n_worlds, rng)` and `act(situation)`."""
    attack = trial.make()
    for name, given in (("reset", (2, [])), ("act", (None,))):
        method = getattr(attack, name, None)
        require(callable(method), f"{name} is missing, or is no method")
        try:
            inspect.signature(method).bind(*given)  # type: ignore[arg-type]
        except TypeError as error:
            require(False, f"{name} cannot be called with {len(given)} arguments: {error}")


def generators_are_a_list(trial: Trial) -> None:
    """`reset` takes a list of one generator a world, as every program hands it; a single generator is a courtesy."""
    attack, world = trial.make(), trial.world()
    attack.reset(2, generators(2))
    attack.act(world.situation())


def delta_fits(trial: Trial) -> None:
    """`act` gives a finite, floating tensor of `situation.delta_shape` on `situation.device`, without a gradient."""
    attack, world = trial.make(), trial.world()
    attack.reset(2, generators(2))
    for _ in range(FRAMES):
        situation = world.situation()
        delta = attack.act(situation)
        require(isinstance(delta, Tensor), f"act gave a {type(delta).__name__}, not a torch.Tensor")
        shape, wanted = tuple(delta.shape), situation.delta_shape
        require(shape == wanted, f"act gave shape {shape}, not (worlds, attackers, C, H, W) = {wanted}")
        require(delta.is_floating_point(), f"δ holds {delta.dtype}, no floating numbers")
        require(delta.device == situation.device, f"δ is on {delta.device}, the worlds are on {situation.device}")
        require(bool(torch.isfinite(delta).all()), "δ holds NaN or infinity")
        require(not delta.requires_grad, "δ still asks for a gradient: hand out delta.detach()")
        world.step(delta)


def budget_is_kept(trial: Trial) -> None:
    """No entry of δ is larger than `situation.budget`: a larger δ is cut down, and is not what was planned."""
    _in_the_ball(trial, "linf")


def norm_is_kept(trial: Trial) -> None:
    """Where `situation.norm` is "l2", no attacker's δ is longer than the budget; entries alone do not count there."""
    _in_the_ball(trial, "l2")


def _in_the_ball(trial: Trial, norm: str) -> None:
    world = trial.world(norm=norm)
    budget = world.settings.budget
    for frame, delta in enumerate(trial.play(trial.make(), world)):
        largest = float(norm_of(delta, norm).max())
        require(
            largest <= budget * (1 + ROUNDING),
            f"frame {frame}: δ has the {norm} norm {largest:g}, the budget is {budget:g}",
        )


def something_is_sent(trial: Trial) -> None:
    """After the grace frame some δ is not zero. (Skip it for an attack that waits.)"""
    require(any(bool(delta.any()) for delta in trial.deltas[1:]), f"δ was zero in {FRAMES - 1} frames and both worlds")


def episodes_repeat(trial: Trial) -> None:
    """The same generators give the same δ, bit for bit: all randomness comes from `rng`."""
    again = trial.play(trial.make(), trial.world())
    for frame, (a, b) in enumerate(zip(trial.deltas, again, strict=True)):
        require(torch.equal(a, b), f"another δ in frame {frame}, from the same generators")


def reset_forgets(trial: Trial) -> None:
    """`reset` begins anew: nothing of the last episode, nor of its number of worlds, shows in the next."""
    attack = trial.make()
    trial.play(attack, trial.world(1, first=5), first=5)
    for frame, (a, b) in enumerate(zip(trial.deltas, trial.play(attack, trial.world()), strict=True)):
        require(torch.equal(a, b), f"frame {frame}: an attack that was played before sends another δ than a fresh one")


def worlds_are_apart(trial: Trial) -> None:
    """A world's δ depends on that world and its generator alone, not on its neighbours."""
    for e in range(2):
        alone = trial.play(trial.make(), trial.world(1, first=e), first=e)
        for frame, (a, b) in enumerate(zip(trial.deltas, alone, strict=True)):
            require(trial.is_close(a[e : e + 1], b), f"frame {frame}: world {e} is attacked otherwise alone")


def every_fleet_is_attacked(trial: Trial) -> None:
    """It plays with one attacker and with three, with the ego among them, and while a vehicle is absent."""
    for attackers in ((2,), (0, 1, 3)):
        world = trial.world(attackers=attackers)
        world.reset([0, 1], options={"absent": {3: [1]}})
        for delta in trial.play(trial.make(), world):
            require(tuple(delta.shape[:2]) == (2, len(attackers)), f"δ of {attackers} has shape {tuple(delta.shape)}")


def detector_is_left_alone(trial: Trial) -> None:
    """The ego's detector is frozen: no weight changes, gathers a gradient or asks for one, and it does not train."""
    detector = trial.bank.detector
    before = detector.digest
    trial.play(trial.make(), trial.world())
    require(detector.digest == before, "the detector's digest changed")
    if isinstance(detector, torch.nn.Module):
        require(not any(part.training for part in detector.modules()), "the detector was put into training mode")
        for name, parameter in detector.named_parameters():
            require(not parameter.requires_grad, f"the detector's parameter {name} was made to ask for a gradient")
            require(parameter.grad is None, f"the detector's parameter {name} has gathered a gradient")


RULES: tuple[AttackRule, ...] = (
    has_the_methods,
    generators_are_a_list,
    delta_fits,
    budget_is_kept,
    norm_is_kept,
    something_is_sent,
    episodes_repeat,
    reset_forgets,
    worlds_are_apart,
    every_fleet_is_attacked,
    detector_is_left_alone,
)


class AttackRuleBroken(AssertionError):
    """An attack does not keep a rule; `rule` is its name."""

    def __init__(self, rule: AttackRule, what: str) -> None:
        self.rule = rule.__name__
        super().__init__(f"{self.rule}: {what}\n  the rule: {rule.__doc__}")


def check_attack(
    attack: Any, *, bank: SceneBank | None = None, tolerance: float = 1e-3, skip: Collection[str] = ()
) -> tuple[str, ...]:
    """Check an attack against every rule.

    Args:
        attack: an attack, of which deep copies are played and which is left untouched, or what makes a new one each
            time: its class, or a function.
        bank: encoded scenes of four vehicles or more with their detector; by default a crossing under ours.
        tolerance: how far entries of δ may differ where a batch may round otherwise than its worlds do.
        skip: names of rules that do not apply, such as "norm_is_kept" for an attack that is made for L∞ alone.

    Returns:
        The names of the rules that were checked, all of them kept.

    Raises:
        AttackRuleBroken: an `AssertionError` that names the first rule broken and says what happened; where the attack
            raised, its exception is the cause, with file and line.
        ValueError: an unknown name in `skip`.
    """
    rules = chosen(RULES, skip)
    ready = not inspect.isclass(attack) and hasattr(attack, "act")
    make: Callable[[], Any] = (lambda: copy.deepcopy(attack)) if ready or not callable(attack) else attack
    trial = Trial(make, bank or SceneBank(Driving(FRAMES), open_detector("cp_env"), progress=False), tolerance)
    for rule in rules:
        try:
            rule(trial)
        except Violation as violation:
            raise AttackRuleBroken(rule, str(violation)) from None
        except Exception as error:
            raise AttackRuleBroken(rule, f"the attack raised {type(error).__name__}: {error}") from error
    return tuple(rule.__name__ for rule in rules)


def chosen(rules: Sequence[Callable[..., None]], skip: Collection[str]) -> list[Callable[..., None]]:
    """The rules but those of these names.

    Raises:
        ValueError: no rule has that name.
    """
    known = {rule.__name__ for rule in rules}
    if unknown := set(skip) - known:
        raise ValueError(f"no rules called {sorted(unknown)}; the rules are {sorted(known)}")
    return [rule for rule in rules if rule.__name__ not in skip]
