"""The driving measures of a played frame."""

from __future__ import annotations

import numpy as np
import pytest

import defenders
from cp_env.metrics import critical, severity, targeted
from cp_env.metrics.surroundings import Surroundings
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import FRAME_METRICS
from tests.cp_env.world.test_world import make, perturbations


def test_the_traffic_is_that_of_the_frame_that_was_played(bank: SceneBank) -> None:
    world = make(bank, 2, attackers=(1, 2), grace_frames=0)
    world.reset([1, 2])
    for t in range(4):
        expected = [
            Surroundings.of(episode.scene, now, int(episode.scene.connected[0]), bank.detector.extent)
            for episode, now in world.places
        ]
        outcome = world.step(perturbations(world, t))
        for e, around in enumerate(expected):
            mine = outcome.surroundings[e]
            assert np.array_equal(mine.boxes.astype(np.float32), outcome.truth[e])
            assert np.array_equal(mine.velocity, around.velocity)
            seen, clean = outcome.output[e].seen.boxes, outcome.clean[e].seen.boxes
            assert tuple(outcome.critical[e]) == critical.critical_recall(seen, around)
            assert outcome.miss_severity[e] == severity.miss_severity(seen, around).max(initial=0.0)
            assert outcome.ghost_severity[e] == severity.ghost_severity(seen, around)
            assert outcome.removed[e] == targeted.removed(seen, clean, around)
            assert outcome.spoofed[e] == targeted.spoofed(seen, clean, around)
            assert outcome.removable[e] == targeted.removable(clean, around)


def test_every_frame_metric_is_one_finite_number_a_world(bank: SceneBank) -> None:
    world = make(bank, 2)
    world.reset([1, 2])
    outcome = world.step(perturbations(world, 0))
    for name, metric in FRAME_METRICS.items():
        value = np.asarray(metric(outcome), dtype=np.float64)
        assert value.shape == (2,) and np.isfinite(value).all(), name


@pytest.mark.parametrize("defender", [name for name in defenders.names() if name != "oracle"])
def test_decodes_are_the_groups_that_were_perceived(
    bank: SceneBank, defender: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = make(bank, 1, defender=defender, attackers=(1, 2), grace_frames=0, max_frames=3)
    world.reset([3])
    for t in range(3):
        rows, perceive = [], world._perceiver

        def counting(*given: object, rows: list[int] = rows, perceive: object = perceive) -> object:
            inner = perceive(*given)  # type: ignore[operator]

            def counted(pairs: list[object]) -> object:
                rows.append(len(pairs))
                return inner(pairs)

            return counted

        with monkeypatch.context() as patch:
            patch.setattr(world, "_perceiver", counting)
            outcome = world.step(perturbations(world, t))
        assert outcome.decodes[0] == sum(rows)
