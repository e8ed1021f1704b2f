"""Whole episodes of one attacker on given scenes, and what they cost the ego."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from agents.policy import Policy
from agents.protocol import Attacker
from cp_env.game import Game
from cp_env.world import Outcome

Move = Callable[[], Outcome]
Player = Callable[[Game, Any, Sequence[np.random.Generator]], Move]
"""From a game just reset, its observations and one stream a world: a function that plays one frame."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """One number an episode."""

    damage: Float[np.ndarray, " n"]  # sum over frames of 1 - Jaccard(output, clean)
    frames: Float[np.ndarray, " n"]
    similarity: Float[np.ndarray, " n"]  # mean over frames, everyone fused against the last output
    verifications: Float[np.ndarray, " n"]  # mean over frames
    excluded: Float[np.ndarray, " n"]  # mean share of the liars that the output left out

    @classmethod
    def joined(cls, parts: Sequence[Episodes]) -> Episodes:
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


def play(game: Game, player: Player, scenes: Sequence[str], seed: int) -> Episodes:
    """One episode on each scene, `game.num_envs` at a time. Seed and scene fix liars and noise, whoever plays."""
    if not scenes or len(scenes) % game.num_envs:
        raise ValueError(f"{len(scenes)} scenes do not fill batches of {game.num_envs} worlds; change either")
    batches = [scenes[i : i + game.num_envs] for i in range(0, len(scenes), game.num_envs)]
    return Episodes.joined([_batch(game, player, batch, seed) for batch in batches])


def _batch(game: Game, player: Player, scenes: Sequence[str], seed: int) -> Episodes:
    observations = begin(game, scenes, seed)
    move = player(game, observations, [np.random.default_rng(_seeds(seed, scene, 1)) for scene in scenes])
    totals = np.zeros((len(fields(Episodes)), game.num_envs))
    over = np.zeros(game.num_envs, dtype=bool)
    while not over.all():
        outcome = move()
        collaborators = [verdict.collaborators for verdict in outcome.verdicts]
        out = [[v not in kept for v in liars] for liars, kept in zip(outcome.attackers, collaborators, strict=True)]
        frame = [
            outcome.damage,
            np.ones(game.num_envs),
            outcome.similarity,
            outcome.verifications,
            np.mean(out, axis=1),
        ]
        totals += np.where(over, 0.0, np.stack(frame))
        over |= outcome.truncated
    damage, frames, *means = totals
    return Episodes(damage, frames, *(total / frames for total in means))


def begin(game: Game, scenes: Sequence[str], seed: int) -> Any:
    """Reset world e to the start of `scenes[e]`; the observations."""
    game.reset([_seeds(seed, scene, 0) for scene in scenes], options={"scene": scenes[0], "start": 0})
    for e, scene in enumerate(scenes):
        observations, _ = game.reset([_seeds(seed, scene, 0)], worlds=[e], options={"scene": scene, "start": 0})
    return observations


def _seeds(seed: int, scene: str, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence([seed, zlib.crc32(scene.encode()), purpose])


def by_policy(policy: Policy) -> Player:
    """A learned attacker, playing the mean of its policy through the game's action map."""

    def player(game: Game, observations: Any, streams: Sequence[np.random.Generator]) -> Move:
        del streams
        held = [observations]

        def move() -> Outcome:
            held[0], *_ = game.step(policy(held[0]))
            assert game.outcome is not None
            return game.outcome

        return move

    return player


def by_chance(game: Game, observations: Any, streams: Sequence[np.random.Generator]) -> Move:
    """Uniform actions through the game's action map."""
    del observations
    shape = (len(game.slots), *game.single_action_space.shape)

    def move() -> Outcome:
        game.step(np.stack([rng.uniform(-1.0, 1.0, shape) for rng in streams]).astype(np.float32))
        assert game.outcome is not None
        return game.outcome

    return move


def by_attacker(attacker: Attacker) -> Player:
    """A scripted attacker, past the action map."""

    def player(game: Game, observations: Any, streams: Sequence[np.random.Generator]) -> Move:
        del observations
        attacker.reset(game.num_envs, streams)
        return lambda: game.world.step(attacker.act(game.world.situation()))

    return player
