"""Drives in live traffic on what the ego perceives: bounds, an attack, and that they repeat."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from agents.arena import make_attack
from cp_env.detector.registry import open_detector
from cp_env.evaluation import Conditions, Run
from cp_env.evaluation.execution.live_drive import LiveDrive, drive_live, drive_on, nothing, truth
from cp_env.scenes.sumo.live import LiveSumo
from cp_env.scenes.sumo.reactive import Stage, open_stage

NAME = "suburban-000000"


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    pytest.importorskip("sumo", reason="needs the extra sumo")
    with open_stage(LiveSumo("suburban"), NAME) as stage:
        yield stage


def attacked(stage: Stage, frames: int, attack: str, k: int) -> LiveDrive:
    conditions = Conditions(stage.source, (NAME,), frames)
    run = Run("none", attack, k, 0, (NAME,))
    return drive_live(stage, run, conditions, open_detector("cp_env", fusion="mean"), make_attack(attack))


def test_who_sees_everyone_stops_and_who_sees_nobody_collides(stage: Stage) -> None:
    seen, blind = (drive_on(stage, perceive, frames=50) for perceive in (truth, nothing))
    assert not seen.drive.collided and seen.frames == 49 and seen.struck == 0
    assert blind.drive.collided and blind.drive.impact_speed > 1 and blind.frames < 49


def test_an_attacked_drive_repeats_and_follows_what_is_seen(stage: Stage) -> None:
    one, again = (attacked(stage, 8, "pgd:steps=3", 2) for _ in range(2))
    assert one == again
    assert one.frames == 7 and one.damage > 0
    calm = attacked(stage, 8, "none", 0)
    assert calm.damage == pytest.approx(0.0, abs=1e-6) and not calm.drive.collided
