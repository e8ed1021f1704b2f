"""What sampling defenders share: thresholds, and their counts compared."""

from __future__ import annotations

import numpy as np

from defenders import Pasac, Prbi, Robosac
from defenders.calibration.files import read_calibration
from defenders.calibration.lookup import SHIPPED
from defenders.simulation.world import SimulatedWorld
from defenders.thresholds.tables import EGO_ONLY


def test_thresholds_by_size_and_by_paper() -> None:
    ladder = {1: 0.2, 2: 0.3, 3: 0.6}
    pair, three = frozenset({0, 1}), frozenset({0, 1, 2})
    for defender in (Pasac(threshold=ladder), Robosac(threshold=ladder)):
        assert (defender.epsilon(pair), defender.epsilon(three)) == (0.3, 0.6)
    assert Pasac(threshold="paper").epsilon(three) == 0.08
    assert Pasac(threshold="paper", score="similarity").epsilon(three) == Robosac().epsilon(three) == 0.3
    assert Pasac(epsilon=0.1).epsilon(three) == 0.1
    shipped = read_calibration(SHIPPED / "mean.json")
    for score, part in EGO_ONLY.items():
        assert Pasac(score=score).epsilon(pair) == shipped.thresholds(part)[2]
    assert Robosac(threshold="calibrated").epsilon(three) == shipped.thresholds("ego_similarity")[3]


def test_passing_is_above_for_pasac_and_at_least_for_robosac() -> None:
    world = SimulatedWorld(3, frozenset(), similarity_model=lambda group, active, rng: 0.3)
    pasac, robosac = Pasac(score="similarity", epsilon=0.3), Robosac(n_attackers=0, epsilon=0.3)
    for defender, flagged in ((pasac, {1, 2}), (robosac, set())):
        defender.reset(3, np.random.default_rng(0))
        assert world.judge(defender).verdict.suspects == flagged


def test_prbi_asks_less_than_both() -> None:
    """The paper's Table 2 in one line: two a frame, after the first."""
    defender, world = Prbi(stopping="never"), SimulatedWorld(5, frozenset({1, 3}))
    defender.reset(5, np.random.default_rng(0))
    world.judge(defender, attack=False)
    world.judge(defender)
    assert max(world.judge(defender).verifications for _ in range(20)) <= 2
