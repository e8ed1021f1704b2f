"""Videos of episodes, and the worst episode of each defender."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from cp_env.evaluation.analysis.worst_episodes import Worst
from cp_env.evaluation.execution.processes import Failure
from cp_env.evaluation.execution.rollout import Rollout
from cp_env.evaluation.execution.workers import MakeAttack, Workers
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.rendering.camera import Camera
from cp_env.rendering.frame import RIGHT, TOP, Image3, write_gif
from cp_env.world.scene_cache import SceneBank

FPS = 2.5


def render_episode(
    run: Run, conditions: Conditions, bank: SceneBank, make_attack: MakeAttack, frames: int | None = None
) -> list[Image3]:
    """The first scene of the run, frame by frame, to its end or for `frames`."""
    rollout = Rollout(replace(run, names=run.names[:1]), conditions, bank, make_attack(run.attack))
    camera, pictures = Camera(rollout.world), []
    while True:
        outcome = rollout.step()
        camera.record(outcome)
        pictures.append(camera.render())
        if outcome.truncated[0] or len(pictures) == frames:
            return pictures


def render_videos(worst: Mapping[str, Worst], conditions: Conditions, workers: Workers) -> Iterator[str]:
    """Render the videos that are missing: every other frame, the defended half of the image.

    Yields the name of each defender whose video is there; a video that cannot be rendered is left out.
    """
    todo = {name: one for name, one in worst.items() if not one.gif.is_file()}
    yield from (name for name in worst if name not in todo)
    names = list(todo)
    for number, video in workers.each(_render_video, [(todo[name].run, conditions, workers) for name in names]):
        if not isinstance(video, Failure):
            write_atomically(todo[names[number]].gif, video)
            yield names[number]


def _render_video(run: Run, conditions: Conditions, workers: Workers) -> bytes:
    pictures = render_episode(run, conditions, workers.open_bank(conditions), workers.make_attack)
    with tempfile.TemporaryDirectory() as folder:
        halves = [picture[TOP - 30 :, RIGHT - 8 :] for picture in pictures[::2]]
        return write_gif(halves, Path(folder) / "video.gif", fps=FPS).read_bytes()
