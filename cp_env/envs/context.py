"""The table of context entries: what a slot is told besides its own map. Size, names and documentation follow from it.

`knowledge` says how much of the defence the context shows:
    black-box   the slot's own role, place and last perturbation, and the clock.
    gray-box    also what the ego's output gave away: similarity, damage, verifications, suspects and collaborators.
    white-box   also the defender's belief, its suspects, all attackers, and the clean score map.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from cp_env.settings import KNOWLEDGE, Settings, choose
from cp_env.world.situation import FRAME_METRICS, Outcome
from cp_env.world.verification import suspicion
from cp_env.world.world import World

POOL = 4
"""Side of the coarse grids in compact vectors."""

SCALE = 64.0
"""Metres that count as 1 in a context."""

MOST_VERIFICATIONS = 8.0
"""Verifications that count as 1 in a context: PRBI's most at n = 5."""


@dataclass(frozen=True, eq=False)
class SlotAssignment:
    """The vehicle that every slot drives, and whether it is malicious."""

    vehicle: Int[np.ndarray, "E S"]
    malicious: Bool[np.ndarray, "E S"]


@dataclass(frozen=True, eq=False)
class Moment:
    """What a context is read from: the worlds before the frame, and the outcome of the last one."""

    world: World
    slots: SlotAssignment
    last: Outcome | None
    fresh: Bool[np.ndarray, " E"]  # worlds in which the episode just began: `last` is not theirs

    @property
    def settings(self) -> Settings:
        return self.world.settings

    def metric(self, name: str, neutral: float = 0.0) -> Float[np.ndarray, " E"]:
        """A frame metric of the last outcome; `neutral` where the episode just began."""
        values = np.full(self.world.num_envs, neutral)
        if self.last is not None:
            values[~self.fresh] = FRAME_METRICS[name](self.last)[~self.fresh]
        return values


@dataclass(frozen=True)
class Column:
    """One entry of the context, or a block of them.

    Attributes:
        name: what the entry is called; a block's entries are `name_0`, `name_1`, ….
        meaning: one line for the documentation.
        unit: of what is measured, before scaling.
        scale: what counts as 1.
        values: [E, S] or [E, S, width] for slots, [E] or [E, width] for what is the same for all slots of a world.
        width: entries, given N maps.
        shared: whether `values` are the same for all slots of a world.
    """

    name: str
    meaning: str
    unit: str
    scale: str
    values: Callable[[Moment], np.ndarray]
    width: Callable[[int], int] = lambda n_maps: 1
    shared: bool = False

    def names(self, n_maps: int) -> tuple[str, ...]:
        width = self.width(n_maps)
        if width == 1 and self.width(2) == self.width(3):
            return (self.name,)
        return tuple(f"{self.name}_{i}" for i in range(width))


def _x(moment: Moment, axis: int) -> np.ndarray:
    pose = moment.world.current().ego_T_sender.cpu().numpy()
    shift: np.ndarray = np.take_along_axis(pose, moment.slots.vehicle[..., None], axis=1)[..., axis] / SCALE
    return shift


def _active(moment: Moment) -> np.ndarray:
    active: np.ndarray = moment.world.current().active.cpu().numpy()
    return active


def _own_norm(moment: Moment) -> np.ndarray:
    norms = np.zeros(moment.slots.vehicle.shape, dtype=np.float32)
    if moment.last is not None:
        norms[moment.slots.malicious] = moment.last.perturbation_norm.ravel()
        norms[moment.fresh] = 0.0
    return norms / max(moment.settings.budget, 1e-9)


def _attackers(moment: Moment) -> np.ndarray:
    attackers = np.zeros((moment.world.num_envs, moment.settings.n_maps), dtype=np.float32)
    np.put_along_axis(attackers, moment.world.attackers, 1.0, axis=1)
    return attackers


def _belief(moment: Moment) -> np.ndarray:
    return np.stack([suspicion(defender, moment.settings.n_maps) for defender in moment.world.defenders])


def _suspects(moment: Moment) -> np.ndarray:
    suspects = np.zeros((moment.world.num_envs, moment.settings.n_maps), dtype=np.float32)
    if moment.last is not None:
        verdicts = moment.last.verdicts
        for e in np.flatnonzero(~moment.fresh).tolist():
            suspects[e, sorted(verdicts[e].suspects)] = 1.0
    return suspects


def _scene(moment: Moment) -> np.ndarray:
    return pooled(moment.world.current().clean.scores[:, None])[:, 0] * POOL**2


def _clock(moment: Moment) -> np.ndarray:
    elapsed: np.ndarray = moment.world.current().frame / moment.settings.max_frames
    return elapsed


def _n(n_maps: int) -> int:
    return n_maps


def _cells(n_maps: int) -> int:
    return POOL**2


COLUMNS: dict[str, tuple[Column, ...]] = {
    "black-box": (
        Column("malicious", "1 if the slot's vehicle is an attacker", "flag", "1", lambda m: m.slots.malicious),
        Column("ego", "1 if it is the ego", "flag", "1", lambda m: m.slots.vehicle == 0),
        Column(
            "excluded",
            "1 if the last verdict left it out of the fusion",
            "flag",
            "1",
            lambda m: np.take_along_axis(m.world.excluded, m.slots.vehicle, axis=1),
        ),
        Column("vehicle", "its number", "number", "N", lambda m: m.slots.vehicle / m.settings.n_maps),
        Column("x", "its place east of the ego", "m", "64 m", lambda m: _x(m, 0)),
        Column("y", "its place north of the ego", "m", "64 m", lambda m: _x(m, 1)),
        Column("time", "frames since the episode began", "frames", "max_frames", _clock, shared=True),
        Column("active", "0 in grace frames, where perturbations do nothing", "flag", "1", _active, shared=True),
        Column("norm", "‖δ‖ that it sent in the last frame", "feature units", "Δ", _own_norm),
    ),
    "gray-box": (
        Column(
            "similarity",
            "Eq. (5) of the full view to the output before",
            "ratio",
            "1",
            lambda m: m.metric("similarity", 1.0),  # before the first frame the output agrees with itself
            shared=True,
        ),
        Column("damage", "detection loss of the last frame", "ratio", "1", lambda m: m.metric("damage"), shared=True),
        Column(
            "verifications",
            "paid in the last frame",
            "count",
            "8",
            lambda m: m.metric("verifications") / MOST_VERIFICATIONS,
            shared=True,
        ),
        Column(
            "n_suspects",
            "vehicles that are flagged",
            "count",
            "N",
            lambda m: m.metric("suspects") / m.settings.n_maps,
            shared=True,
        ),
        Column(
            "n_collaborators",
            "vehicles that were fused",
            "count",
            "N",
            lambda m: m.metric("collaborators") / m.settings.n_maps,
            shared=True,
        ),
        Column(
            "converged", "1 if the defender has converged", "flag", "1", lambda m: m.metric("converged"), shared=True
        ),
    ),
    "white-box": (
        Column(
            "own",
            "1 at the slot's vehicle",
            "flag",
            "1",
            lambda m: np.eye(m.settings.n_maps, dtype=np.float32)[m.slots.vehicle],
            _n,
        ),
        Column("attacker", "1 at every attacker", "flag", "1", _attackers, _n, shared=True),
        Column("belief", "the defender's probability of an attack", "probability", "1", _belief, _n, shared=True),
        Column("suspect", "1 at every vehicle that is flagged", "flag", "1", _suspects, _n, shared=True),
        Column("scene", "mean clean score on a grid of 4 × 4", "probability", "1/16", _scene, _cells, shared=True),
    ),
}
"""Entries by the knowledge that first shows them; each level shows those of the levels before it, too."""


def columns_of(knowledge: str) -> tuple[Column, ...]:
    """The entries that a slot of this knowledge is shown, in order."""
    level = KNOWLEDGE.index(choose("knowledge", knowledge, KNOWLEDGE))
    return tuple(column for name in KNOWLEDGE[: level + 1] for column in COLUMNS[name])


def context_names(knowledge: str = "black-box", n_maps: int = 5) -> tuple[str, ...]:
    """The name of every entry of `context`, in order.

    Args:
        knowledge: "black-box", "gray-box" or "white-box".
        n_maps: N, vehicles that share a map, the road-side unit included.

    Returns:
        As many names as `context` has entries.
    """
    return tuple(name for column in columns_of(knowledge) for name in column.names(n_maps))


def read_context(columns: Sequence[Column], moment: Moment) -> Float[np.ndarray, "E S c"]:
    """The entries of every slot, in [-1, 1]."""
    n_slots = moment.slots.vehicle.shape[1]
    parts = []
    for column in columns:
        values = np.asarray(column.values(moment), dtype=np.float32)
        if column.shared:
            values = np.repeat(values[:, None], n_slots, axis=1)
        parts.append(values[..., None] if values.ndim == 2 else values)
    return np.clip(np.concatenate(parts, axis=-1), -1.0, 1.0).astype(np.float32)


def pooled(maps: Float[Tensor, "E S H W"]) -> Float[np.ndarray, "E S p"]:
    """Means over a coarse grid of `POOL` × `POOL`, flattened."""
    means: np.ndarray = functional.adaptive_avg_pool2d(maps, POOL).flatten(2).cpu().numpy()
    return means
