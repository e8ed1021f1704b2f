"""Random streams: seeds are seeds, roles are apart, and nothing that is handed out leads back."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.world.scene_cache import SceneBank
from cp_env.world.streams import Stream, keyed_generator
from cp_env.world.world import World
from defenders import NoDefence

ROLES = ("scene", "attackers", "defender", "attack")


def state(rng: np.random.Generator) -> Any:
    return rng.bit_generator.state["state"]


@given(st.integers(0, 2**70), st.integers(0, 5))
def test_a_seed_an_episode_and_a_role_give_one_generator(seed: int, episodes: int) -> None:
    stream = Stream.of(seed)
    for _ in range(episodes):
        stream = stream.next()
    states = [str(state(stream.generator(role))) for role in ROLES]
    assert states == [str(state(stream.generator(role))) for role in ROLES]
    others = [stream.next(), Stream.of(seed + 1), Stream((seed,), episodes + 7)]
    assert len({*states, *(str(state(other.generator(role))) for other in others for role in ROLES)}) == 16


def test_a_key_hides_every_role() -> None:
    public, hidden = (str(state(Stream.of(3).generator("attackers", key))) for key in ("cp_env", "secret"))
    assert public != hidden == str(state(Stream.of(3).generator("attackers", "secret")))


def test_words_are_not_run_together() -> None:
    pairs = [("k", 1, 23), ("k", 12, 3), ("k", "1", 23), ("k", "12", "3"), ("k1", 23)]
    assert len({str(state(keyed_generator(*words))) for words in pairs}) == len(pairs)


def test_a_spawned_generator_differs_by_its_parent() -> None:
    first, second = (Stream.of(seed).generator("attack").spawn(1)[0] for seed in (1, 2))
    assert state(first) != state(second)


@pytest.mark.parametrize("seed", [-1, 0.5, True, "0", None])
def test_what_is_no_seed_is_told(seed: Any) -> None:
    with pytest.raises(ValueError, match="a seed is a whole number"):
        Stream.of(seed)


def test_sequences_are_seeds_too() -> None:
    first, second = (Stream.of(child) for child in np.random.SeedSequence(5).spawn(2))
    assert first != second and Stream.of(np.random.SeedSequence(5).spawn(2)[0]) == first
    assert Stream.of(np.random.SeedSequence()) != Stream.of(np.random.SeedSequence())
    assert pickle.loads(pickle.dumps(first)) == first


class Digger(NoDefence):
    """Tries to rebuild the draw of attackers from what it is handed, as it could from a spawned seed sequence."""

    guesses: Sequence[tuple[int, ...]] = ()

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        super().reset(n_vehicles, rng)
        sequence = rng.bit_generator.seed_seq
        assert isinstance(sequence, np.random.SeedSequence)
        parents = [np.random.SeedSequence(sequence.entropy, spawn_key=sequence.spawn_key[:-1]), sequence]
        children = [child for parent in parents for child in parent.spawn(4)]
        drawn = [np.random.default_rng(child).choice(n_vehicles, 2, replace=False) for child in children]
        self.guesses = [tuple(sorted(int(i) for i in one)) for one in drawn]


def test_the_draw_of_attackers_cannot_be_rebuilt_from_a_handed_generator(bank: SceneBank) -> None:
    """Eight guesses hit one of ten pairs as often as chance: 1 - 0.9^8 = 0.57 of episodes in the mean."""
    world = World(1, defender=Digger(), bank=bank, max_frames=2)
    hits = []
    for seed in range(60):
        world.reset([seed])
        (digger,) = world.defenders
        assert isinstance(digger, Digger)
        hits.append([guess == tuple(world.attackers[0]) for guess in digger.guesses])
    share = np.mean(hits, axis=0)
    assert share.max() < 0.35, "no way of guessing is better than chance, 0.1, by more than four standard deviations"
