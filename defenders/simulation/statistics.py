"""Statistics of thousands of episodes in the simulated world.

scenario = Scenario(n_vehicles=5, n_attackers=2)
stats = play_many(Prbi(), scenario, episodes=20_000, seed=0)
stats.first.mean(), stats.frames.mean(), stats.false_accusation_rate.mean()
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt64

from defenders.protocol import Defender
from defenders.simulation.world import Episode, Scenario

MOST_VEHICLES = 64  # the bits of a mask


@dataclass(frozen=True, eq=False)
class EpisodeStats:
    """Statistics of E episodes of at most T recorded frames. Sets of vehicles are bit masks: bit i is vehicle i.

    Column t is recorded frame t. Behind the end of an episode `verifications` is -1 and masks are 0.
    """

    n_vehicles: int
    attackers: UInt64[np.ndarray, " E"]
    frames: Int[np.ndarray, " E"]  # recorded
    converged: Bool[np.ndarray, " E"]  # in the last of them
    verifications: Int[np.ndarray, "E T"]
    active: UInt64[np.ndarray, "E T"]  # active attackers in a frame
    fused: UInt64[np.ndarray, "E T"]  # collaborators
    flagged: UInt64[np.ndarray, "E T"]  # suspects

    @property
    def first_abnormal(self) -> Int[np.ndarray, " E"]:
        """The first column with an active attacker; -1 where there is none."""
        return np.where(self.active.any(axis=1), (self.active != 0).argmax(axis=1), -1)

    @property
    def first(self) -> Int[np.ndarray, " F"]:
        """Verifications in the first abnormal frame of the episodes that have one."""
        rows = np.flatnonzero(self.first_abnormal >= 0)
        return self.verifications[rows, self.first_abnormal[rows]]

    @property
    def all_verifications(self) -> Int[np.ndarray, " F"]:
        """Verifications in every recorded frame of every episode, in a row."""
        return self.verifications[self.verifications >= 0]

    @property
    def flagged_last(self) -> Bool[np.ndarray, "E n"]:
        """Whether a vehicle is flagged in the last frame."""
        return members(self._last(self.flagged), self.n_vehicles)

    @property
    def flagged_since(self) -> Int[np.ndarray, "E n"]:
        """The column since which a vehicle has been flagged up to the end; -1 if it is not flagged at the end."""
        behind = np.arange(self.flagged.shape[1]) >= self.frames[:, None]
        unflagged = ~members(self.flagged, self.n_vehicles) & ~behind[:, :, None]
        last_unflagged = np.where(unflagged.any(axis=1), unflagged.shape[1] - 1 - unflagged[:, ::-1].argmax(axis=1), -1)
        return np.where(self.flagged_last, last_unflagged + 1, -1)

    @property
    def identified(self) -> Float[np.ndarray, " E"]:
        """ID rate: share of the attackers that are flagged in the last frame; NaN where there are none."""
        return _share(self.flagged_last, members(self.attackers, self.n_vehicles))

    @property
    def false_accusation_rate(self) -> Float[np.ndarray, " E"]:
        """MC rate: share of the benign vehicles that are flagged in the last frame."""
        return _share(self.flagged_last, ~members(self.attackers, self.n_vehicles))

    @property
    def exact_identification(self) -> Bool[np.ndarray, " E"]:
        """Whether exactly the attackers are flagged in the last frame."""
        return self._last(self.flagged) == self.attackers

    @property
    def fused_attackers(self) -> Int[np.ndarray, "E T"]:
        """Number of active attackers among the collaborators of a frame."""
        return members(self.fused & self.active, self.n_vehicles).sum(axis=2)

    def _last(self, masks: UInt64[np.ndarray, "E T"]) -> UInt64[np.ndarray, " E"]:
        return masks[np.arange(len(masks)), self.frames - 1]


def play_many(defender: Defender, scenario: Scenario, *, episodes: int, seed: int) -> EpisodeStats:
    """Play episodes one after another with one defender.

    Episode i is `scenario.play(defender, np.random.SeedSequence([seed, i]))`, whatever the others are.

    Args:
        defender: The defender.
        scenario: Conditions of the episodes; at most 64 vehicles.
        episodes: Number of episodes, at least 1.
        seed: Seed of all episodes.

    Returns:
        Their statistics.

    Raises:
        ValueError: If there are no episodes or too many vehicles.
    """
    if episodes < 1 or scenario.n_vehicles > MOST_VEHICLES:
        raise ValueError(
            f"at least 1 episode with at most {MOST_VEHICLES} vehicles, got {episodes} with {scenario.n_vehicles}; "
            "larger fleets can be played one by one with Scenario.play"
        )
    return record(
        scenario.n_vehicles, (scenario.play(defender, np.random.SeedSequence([seed, i])) for i in range(episodes))
    )


def record(n_vehicles: int, episodes: Iterable[Episode]) -> EpisodeStats:
    """Statistics of one or more episodes. Nothing else of them is kept."""
    attackers, converged, frames = [], [], []
    columns: tuple[list[int], list[int], list[int], list[int]] = ([], [], [], [])  # of all frames in a row
    for episode in episodes:
        attackers.append(_mask(episode.attackers))
        converged.append(episode.converged)
        frames.append(len(episode.results))
        for result in episode.results:
            verdict = result.verdict
            row = result.verifications, _mask(result.active), _mask(verdict.collaborators), _mask(verdict.suspects)
            for column, value in zip(columns, row, strict=True):
                column.append(value)
    played = np.arange(max(frames)) < np.array(frames)[:, None]
    verifications, *masks = columns
    active, fused, flagged = (_spread(np.array(mask, dtype=np.uint64), played, 0) for mask in masks)
    return EpisodeStats(
        n_vehicles=n_vehicles,
        attackers=np.array(attackers, dtype=np.uint64),
        frames=np.array(frames),
        converged=np.array(converged),
        verifications=_spread(np.array(verifications), played, -1),
        active=active,
        fused=fused,
        flagged=flagged,
    )


def members(masks: UInt64[np.ndarray, "*any"], n_vehicles: int) -> Bool[np.ndarray, "*any n"]:
    """Unpacked masks: whether vehicle i is in each of them."""
    return (masks[..., None] >> np.arange(n_vehicles, dtype=np.uint64)) & np.uint64(1) == 1


@lru_cache(maxsize=2**16)
def _mask(group: frozenset[int]) -> int:
    return sum(1 << i for i in group)


def _spread(
    values: Shaped[np.ndarray, " F"], played: Bool[np.ndarray, "E T"], behind: int
) -> Shaped[np.ndarray, "E T"]:
    """The values in the frames that were played, episode after episode, and `behind` in the others."""
    table = np.full(played.shape, behind, dtype=values.dtype)
    table[played] = values
    return table


def _share(who: Bool[np.ndarray, "E n"], among: Bool[np.ndarray, "E n"]) -> Float[np.ndarray, " E"]:
    counted = among.sum(axis=1)
    return np.where(counted > 0, (who & among).sum(axis=1) / np.maximum(counted, 1), np.nan)
