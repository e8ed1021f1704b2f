"""A drive in live traffic that reacts: the defended output of each frame moves the ego, and the next frame follows.

Attack, defender and detector are those of any episode (`cp_env.world`). Only the scene is made while it is played: the
world reads its frames from a bank that holds the traffic as it is now.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float16, Shaped

from cp_env.attack import Attack, Learned
from cp_env.detector.protocol import DetectorLike, UsesEgoSweep
from cp_env.driving import Drive
from cp_env.driving.reactive import ClosedLoop
from cp_env.evaluation.execution.rollout import Rollout
from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.geometry.planar import grid_origin
from cp_env.metrics.ground_truth import truth_boxes
from cp_env.scenes.sumo.reactive import ReactiveTraffic, Stage
from cp_env.types import Detections, Scene, View
from cp_env.world.episode import Episode
from cp_env.world.map_store import MapStore
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome

Perceive = Callable[[Scene, int], Shaped[np.ndarray, "_ 5"]]
"""Boxes that the ego perceives in a frame of a scene, in its grid frame."""


@dataclass(frozen=True, kw_only=True)
class LiveDrive:
    """What became of one drive."""

    drive: Drive
    struck: int  # vehicles that drove into the ego from behind
    crossed: int  # contacts with crossing or oncoming vehicles, which are no collision of `drive`
    frames: int
    damage: float  # detection loss per frame; 0 without a detector


class LiveMaps(MapStore):
    """The maps of the frame of now, in memory alone: no other frame is there yet."""

    _held_for: tuple[int, tuple[int, ...]] | None = None
    _maps_now: list[Float16[np.ndarray, "C H W"]]

    def maps(self, scene: Scene, agents: Sequence[int], frame: int) -> list[Float16[np.ndarray, "C H W"]]:
        """What each agent encodes of the frame, in its own grid frame."""
        if self._held_for != (frame, tuple(agents)):
            (sweeps,) = self.source.sweeps(scene, [frame])
            with torch.inference_mode():
                encoded = [self.detector.encode([sweeps[agent]])[0] for agent in agents]
                self._maps_now = [one.to(torch.float16).cpu().numpy().copy() for one in encoded]
            self._held_for = (frame, tuple(agents))
        return self._maps_now

    def ego_context(self, scene: Scene, frame: int) -> Shaped[np.ndarray, "..."]:
        """What the ego keeps of its own sweep."""
        assert isinstance(self.detector, UsesEgoSweep)
        (sweeps,) = self.source.sweeps(scene, [frame])
        with torch.inference_mode():
            return np.array(self.detector.ego_context(sweeps[:1]).cpu().numpy()[0])


class LiveBank(SceneBank):
    """The bank of one scene that is made while it is played: the episode is that of the traffic of now."""

    def __init__(self, traffic: ReactiveTraffic, detector: DetectorLike) -> None:
        super().__init__(traffic, detector, progress=False)
        self.traffic = traffic
        self.store = LiveMaps(traffic, detector, self.store.folder, "live", False)
        self._now: tuple[Scene, int, bool, Episode] | None = None

    def episode(self, name: str, n_vehicles: int, rsu: bool) -> Episode:
        """The episode of the traffic, up to now."""
        if self._now is None or self._now[:3] != (self.traffic.scene, n_vehicles, rsu):
            self._now = (self.traffic.scene, n_vehicles, rsu, self._build(name, n_vehicles, rsu))
        return self._now[3]


def drive_live(
    stage: Stage,
    run: Run,
    conditions: Conditions,
    detector: DetectorLike,
    attack: Attack | Learned,
    *,
    perceived: Callable[[Outcome], View] = lambda outcome: outcome.output[0],
) -> LiveDrive:
    """One drive on what the ego perceives through detector and defence, under an attack.

    Args:
        stage: the scene.
        run: defender, number of attackers and seed; its scenes are not played.
        conditions: fleet, budget and length of the drive.
        detector: the victim.
        attack: scripted or learned.
        perceived: the view that the ego acts on; the defended output by default.

    Raises:
        ValueError: the scene has fewer connected vehicles than the conditions ask for.
    """
    damage: list[float] = []
    with stage.traffic(frames=conditions.frames, connected=conditions.n_vehicles) as traffic:
        one = Run(run.defender, run.attack, run.k, run.seed, (stage.name,))
        rollout = Rollout(one, conditions, LiveBank(traffic, detector), attack)
        loop = ClosedLoop(traffic)
        while not loop.over:
            outcome = rollout.step()
            damage.append(float(outcome.damage[0]))
            loop.step([perceived(outcome)])
        return _result(loop, damage)


def drive_on(stage: Stage, perceive: Perceive, *, frames: int = 100) -> LiveDrive:
    """One drive on boxes that no detector finds: the bounds of `drive_live`.

    Args:
        stage: the scene.
        perceive: boxes of a frame.
        frames: length of the drive.
    """
    with stage.traffic(frames=frames) as traffic:
        loop = ClosedLoop(traffic)
        while not loop.over:
            scene, frame = traffic.scene, traffic.frame
            boxes = perceive(scene, frame)
            seen = Detections(boxes, np.ones(len(boxes)))
            origin = grid_origin(scene.pose[frame, int(scene.connected[0]), :2])
            loop.step([View(frozenset({0}), frame, origin, seen, seen, np.zeros((1, 1)))])
        return _result(loop, [])


def truth(scene: Scene, frame: int, extent: float = 32.0) -> Shaped[np.ndarray, "_ 5"]:
    """Every vehicle in range."""
    return truth_boxes(scene, frame, int(scene.connected[0]), extent).astype(np.float64)


def nothing(scene: Scene, frame: int) -> Shaped[np.ndarray, "_ 5"]:
    """No vehicle."""
    return np.zeros((0, 5))


def _result(loop: ClosedLoop, damage: Sequence[float]) -> LiveDrive:
    (drive,) = loop.drives()
    return LiveDrive(
        drive=drive,
        struck=loop.struck,
        crossed=loop.crossed,
        frames=len(loop.history),
        damage=float(np.mean(damage)) if damage else 0.0,
    )
