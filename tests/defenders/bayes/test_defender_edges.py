"""The references of `Bayes` age frame by frame until they are replaced, and densities of that age are used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from defenders.bayes.defender import Bayes


@dataclass
class ScriptedFrame:
    """A frame whose views are (index, group): all of one frame resemble each other, and earlier ones as scripted."""

    index: int
    similar: float
    n_vehicles: int = 4

    @property
    def present(self) -> frozenset[int]:
        return frozenset(range(self.n_vehicles))

    @property
    def seen(self) -> Any:
        return (self.index, self.present)

    def similarity(self, a: Any, b: Any) -> float:
        return 0.95 if a[0] == b[0] else self.similar

    def agreement(self, a: Any, b: Any) -> float:
        return 0.0


def play(defender: Bayes, frame: ScriptedFrame) -> None:
    inspection, answer = defender.inspect(frame), None
    try:
        while True:
            query = next(inspection) if answer is None else inspection.send(answer)
            answer = [(frame.index, group) for group in query.groups]
    except StopIteration:
        pass


@pytest.mark.parametrize("likelihood", ["calibrated", "perfect"])
def test_references_are_as_old_as_the_frames_since_they_were_seen(
    likelihood: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two frames renew them; then nothing is good enough for four frames, and then anything is."""
    defender = Bayes(likelihood=likelihood)
    defender.reset(4, np.random.default_rng(0))
    ages = []
    for index, margin in enumerate([0.0, 0.0, 1e9, 1e9, 1e9, 1e9, 0.0, 0.0]):
        monkeypatch.setattr("defenders.bayes.defender.RENEW_MARGIN", margin)
        play(defender, ScriptedFrame(index, 0.8))
        (since,) = {view[0] for view in defender.references.values()}
        assert defender.age == index - since
        if defender.age:
            tables = defender.fleet.tables
            table = tables[min(defender.age, len(tables)) - 1]
            assert all(source.table is table for source in defender._sources())
        ages.append(defender.age)
    assert ages == [0, 0, 1, 2, 3, 4, 0, 0]
