"""Episodes under an instrument: as long as asked, from where asked, and never without a measurement."""

from __future__ import annotations

import numpy as np
import pytest

from agents.calibration.episode import watch
from cp_env.world.scene_cache import SceneBank
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict


class Counting(Defender):
    """Counts frames; with `spy` it asks for all groups and pays for none, which no defender may."""

    def __init__(self, spy: bool = False) -> None:
        self.spy = spy

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.seen, self.draw = n_vehicles, 0, float(rng.random())

    def inspect(self, frame: Frame) -> Inspection:
        self.seen += 1
        if self.spy:
            yield Query([{0, i} for i in range(1, self.n)], verification=False)
        return Verdict(frame.present)


def watched(bank: SceneBank, frames: int = 2, *, spy: bool = False, seed: int = 0, **options: int) -> Counting:
    rng = np.random.default_rng(seed)
    return watch(Counting(spy), bank, "toy-0", "noise", frames, entropy=[seed], rng=rng, n_vehicles=3, **options)


@pytest.mark.parametrize(("frames", "start", "played"), [(2, 0, 2), (9, 0, 5), (9, 3, 2)])
def test_so_many_frames_or_to_the_end(toy_bank: SceneBank, frames: int, start: int, played: int) -> None:
    assert watched(toy_bank, frames, start=start).seen == played


def test_without_a_start_it_is_drawn_with_the_rest(toy_bank: SceneBank, starts: list[int]) -> None:
    draws = {watched(toy_bank, max_frames=2, seed=seed).draw for seed in (*range(6), *range(6))}
    assert len(draws) == 6 and starts[:6] == starts[6:] and len(set(starts)) > 1


def test_an_instrument_that_breaks_a_rule_has_measured_nothing(toy_bank: SceneBank) -> None:
    with pytest.raises(RuntimeError, match="the instrument failed"):
        watched(toy_bank, spy=True)
