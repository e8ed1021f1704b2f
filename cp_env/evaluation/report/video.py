"""Videos of episodes, and the worst episode of each defender."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from cp_env.evaluation.analysis.worst_episodes import Worst
from cp_env.evaluation.execution.processes import Failure
from cp_env.evaluation.execution.rollout import Rollout
from cp_env.evaluation.execution.workers import MakeAttack, Workers
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.rendering.camera import Camera
from cp_env.rendering.frame import draw, draw_output
from cp_env.rendering.gif import write_gif
from cp_env.rendering.panel import Image3
from cp_env.rendering.picture import Picture, standing_points, telling_frame
from cp_env.world.scene_cache import SceneBank

FPS = 5.0  # as many frames as the recordings have a second
SLOW = 2.5  # every other frame at half the rate
Layout = Callable[[Picture], Image3]


def record_episode(
    run: Run, conditions: Conditions, bank: SceneBank, make_attack: MakeAttack, frames: int | None = None
) -> list[Picture]:
    """What the first scene of the run shows, frame by frame, to its end or for `frames`."""
    rollout = Rollout(replace(run, names=run.names[:1]), conditions, bank, make_attack(run.attack))
    return record_rollout(rollout, run, frames)


def record_rollout(rollout: Rollout, run: Run, frames: int | None = None) -> list[Picture]:
    """What the first world of a run's rollout shows, frame by frame, to its end or for `frames`."""
    camera, pictures = Camera(rollout.world, run.attack), list[Picture]()
    while True:
        outcome = rollout.step()
        camera.record(outcome)
        pictures.append(replace(camera.picture(0), defence=run.defender))  # with its options
        if outcome.truncated[0] or len(pictures) == frames:
            return pictures


def write_film(
    pictures: Sequence[Picture], path: Path, *, layout: Layout = draw, every: int = 1, fps: float = FPS
) -> Path:
    """Write an episode as an endlessly repeating GIF that begins with its telling frame; returns the path.

    LiDAR points of the ground are left out: they are a quarter of the file.

    Args:
        pictures: the frames of the episode.
        path: of the file.
        layout: `draw` for both panels, `draw_output` for the defended output alone.
        every: one frame of so many is shown.
        fps: frames that are shown per second.
    """
    shown = [standing_points(picture) for picture in pictures[::every]]
    return write_gif([layout(picture) for picture in shown], path, fps=fps, first=telling_frame(shown))


def render_videos(worst: Mapping[str, Worst], conditions: Conditions, workers: Workers) -> Iterator[str]:
    """Render the videos that are missing: every other frame, the defended output alone.

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
    pictures = record_episode(run, conditions, workers.open_bank(conditions), workers.make_attack)
    with tempfile.TemporaryDirectory() as folder:
        film = write_film(pictures, Path(folder) / "video.gif", layout=draw_output, every=2, fps=SLOW)
        return film.read_bytes()
