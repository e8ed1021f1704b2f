"""Thousands of episodes in the world without scenes, and numbers of all that happened in them.

terms = Terms(n_vehicles=5, n_liars=2)
tally = play_many(Prbi(), terms, episodes=20_000, seed=0)
tally.first.mean(), tally.frames.mean(), tally.wronged.mean()
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt64

from defenders.protocol import Defender
from defenders.simulation.world import Episode, Terms

MOST_VEHICLES = 64  # the bits of a mask


@dataclass(frozen=True, eq=False)
class Tally:
    """What happened in E episodes of at most T recorded frames. Sets of vehicles are bit masks: bit i is vehicle i.

    Column t is the recorded frame t; behind the end of an episode are -1 in `verifications`, 0 in the masks.
    """

    n_vehicles: int
    liars: UInt64[np.ndarray, " E"]
    frames: Int[np.ndarray, " E"]  # recorded
    converged: Bool[np.ndarray, " E"]  # in the last of them
    verifications: Int[np.ndarray, "E T"]
    lying: UInt64[np.ndarray, "E T"]  # who lied in a frame
    fused: UInt64[np.ndarray, "E T"]  # collaborators
    accused: UInt64[np.ndarray, "E T"]  # suspects

    @property
    def first_abnormal(self) -> Int[np.ndarray, " E"]:
        """The first column in which somebody lied; -1 where nobody did."""
        return np.where(self.lying.any(axis=1), (self.lying != 0).argmax(axis=1), -1)

    @property
    def first(self) -> Int[np.ndarray, " F"]:
        """Verifications of the first abnormal frame, in the episodes that have one."""
        rows = np.flatnonzero(self.first_abnormal >= 0)
        return self.verifications[rows, self.first_abnormal[rows]]

    @property
    def all_verifications(self) -> Int[np.ndarray, " F"]:
        """Verifications of every recorded frame of every episode, in a row."""
        return self.verifications[self.verifications >= 0]

    @property
    def convicted(self) -> Bool[np.ndarray, "E n"]:
        """Who is accused in the last frame."""
        return members(self._last(self.accused), self.n_vehicles)

    @property
    def convicted_since(self) -> Int[np.ndarray, "E n"]:
        """The column since which a vehicle has been accused without a break to the end; -1 for who is not."""
        behind = np.arange(self.accused.shape[1]) >= self.frames[:, None]
        spared = ~members(self.accused, self.n_vehicles) & ~behind[:, :, None]
        last_spared = np.where(spared.any(axis=1), spared.shape[1] - 1 - spared[:, ::-1].argmax(axis=1), -1)
        return np.where(self.convicted, last_spared + 1, -1)

    @property
    def identified(self) -> Float[np.ndarray, " E"]:
        """Share of the liars accused in the last frame; NaN where there are none."""
        return _share(self.convicted, members(self.liars, self.n_vehicles))

    @property
    def wronged(self) -> Float[np.ndarray, " E"]:
        """Share of the innocents accused in the last frame."""
        return _share(self.convicted, ~members(self.liars, self.n_vehicles))

    @property
    def solved(self) -> Bool[np.ndarray, " E"]:
        """Whether exactly the liars are accused in the last frame."""
        return self._last(self.accused) == self.liars

    @property
    def deceived(self) -> Int[np.ndarray, "E T"]:
        """How many of a frame's collaborators lied in it."""
        return members(self.fused & self.lying, self.n_vehicles).sum(axis=2)

    def _last(self, masks: UInt64[np.ndarray, "E T"]) -> UInt64[np.ndarray, " E"]:
        return masks[np.arange(len(masks)), self.frames - 1]


def play_many(defender: Defender, terms: Terms, *, episodes: int, seed: int) -> Tally:
    """Play `episodes`, one after another, with one defender. ValueError for none, and above 64 vehicles.

    Episode i is `terms.play(defender, np.random.SeedSequence([seed, i]))`, whatever the others are.
    """
    if episodes < 1 or terms.n_vehicles > MOST_VEHICLES:
        raise ValueError(
            f"at least 1 episode with at most {MOST_VEHICLES} vehicles, got {episodes} with {terms.n_vehicles}; "
            "larger fleets can be played one by one with Terms.play"
        )
    return record(terms.n_vehicles, (terms.play(defender, np.random.SeedSequence([seed, i])) for i in range(episodes)))


def record(n_vehicles: int, episodes: Iterable[Episode]) -> Tally:
    """The numbers of some episodes, one at least; nothing else of them is kept."""
    liars, converged, frames = [], [], []
    columns: tuple[list[int], list[int], list[int], list[int]] = ([], [], [], [])  # of all frames in a row
    for episode in episodes:
        liars.append(_mask(episode.liars))
        converged.append(episode.converged)
        frames.append(len(episode.rulings))
        for ruling in episode.rulings:
            verdict = ruling.verdict
            row = ruling.verifications, _mask(ruling.lying), _mask(verdict.collaborators), _mask(verdict.suspects)
            for column, value in zip(columns, row, strict=True):
                column.append(value)
    played = np.arange(max(frames)) < np.array(frames)[:, None]
    verifications, *masks = columns
    lying, fused, accused = (_spread(np.array(mask, dtype=np.uint64), played, 0) for mask in masks)
    return Tally(
        n_vehicles=n_vehicles,
        liars=np.array(liars, dtype=np.uint64),
        frames=np.array(frames),
        converged=np.array(converged),
        verifications=_spread(np.array(verifications), played, -1),
        lying=lying,
        fused=fused,
        accused=accused,
    )


def members(masks: UInt64[np.ndarray, "*any"], n_vehicles: int) -> Bool[np.ndarray, "*any n"]:
    """Masks taken apart: whether vehicle i is in each of them."""
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
