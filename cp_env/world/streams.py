"""Random streams by a keyed hash: one generator for each role, from which no other role's can be worked out.

A generator's seed is BLAKE2b(key; seed of the stream, number of the episode, role). With the public key a seed is a
seed: everyone gets the same episode from it. A benchmark that hides its episodes sets a key of its own: then neither
the draw of attackers nor another side's random numbers follow from what a plug-in is handed.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from defenders.registry import shown

PUBLIC_KEY = "cp_env"
"""The key where none is set."""


@dataclass(frozen=True)
class Stream:
    """The episodes that follow from one seed.

    Attributes:
        entropy: the words of the seed.
        episode: episodes begun so far.
    """

    entropy: tuple[int, ...]
    episode: int = 0

    @classmethod
    def of(cls, seed: object) -> Stream:
        """The stream that a seed begins: a whole number, or a NumPy `SeedSequence`.

        Raises:
            ValueError: it is neither.
        """
        if isinstance(seed, np.random.SeedSequence):
            return cls((*_words(seed.entropy), -1, *seed.spawn_key))
        if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
            raise ValueError(f"a seed is a whole number >= 0, not {shown(seed)}")
        return cls((int(seed),))

    def next(self) -> Stream:
        """The stream after one more episode."""
        return replace(self, episode=self.episode + 1)

    def generator(self, role: str, key: str = PUBLIC_KEY) -> np.random.Generator:
        """The generator of one role in the coming episode."""
        return keyed_generator(key, *self.entropy, "episode", self.episode, role)


def keyed_generator(key: str, *words: int | str) -> np.random.Generator:
    """A generator whose seed is the keyed hash of the words; it tells neither them nor the key.

    Args:
        key: any text.
        words: what the generator is for; the order counts.

    Returns:
        A generator. It may be spawned: its seed sequence holds the hash and nothing else.
    """
    text = "\x1f".join(f"{type(word).__name__[0]}{word}" for word in words)
    secret = hashlib.blake2b(key.encode(), digest_size=32).digest()
    digest = hashlib.blake2b(text.encode(), key=secret, digest_size=16).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))


def name_of_key(key: str) -> str:
    """A name by which results say that they were made with the same key. It tells a long, random key to nobody."""
    return hashlib.blake2b(key.encode(), digest_size=8, person=b"name of key").hexdigest()


def _words(entropy: object) -> tuple[int, ...]:
    if entropy is None:
        return ()
    return tuple(int(word) for word in np.atleast_1d(np.asarray(entropy, dtype=object)))
