"""An episode as pictures, and which episodes are worth one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from cp_env.evaluation.analysis.worst_episodes import Worst
from cp_env.evaluation.execution.processes import Failure
from cp_env.evaluation.execution.rollout import Stage
from cp_env.evaluation.execution.workers import Crew, MakeAttacker
from cp_env.evaluation.plan.records import write_atomically
from cp_env.evaluation.plan.runs import Cell, Protocol, parse
from cp_env.rendering.camera import Camera
from cp_env.rendering.frame import RIGHT, TOP, Image3, write_gif
from cp_env.world.scene_cache import SceneBank

FPS = 2.5


def film(
    cell: Cell, protocol: Protocol, bank: SceneBank, make_attacker: MakeAttacker, frames: int | None = None
) -> list[Image3]:
    """The first scene of the cell, frame by frame, to its end or for `frames`."""
    name, knobs = parse(cell.attack)
    stage = Stage(replace(cell, names=cell.names[:1]), protocol, bank, make_attacker(name, **knobs))
    camera, pictures = Camera(stage.world), []
    while True:
        outcome = stage.move()
        camera.watch(outcome)
        pictures.append(camera.shoot())
        if outcome.truncated[0] or len(pictures) == frames:
            return pictures


def shoot(worst: Mapping[str, Worst], protocol: Protocol, crew: Crew) -> Iterator[str]:
    """Film those episodes that are not filmed yet: every other frame, the defended half of the picture. Hands out the
    defender's name when its film is there; one that cannot be filmed is left out."""
    todo = {name: one for name, one in worst.items() if not one.gif.is_file()}
    yield from (name for name in worst if name not in todo)
    names = list(todo)
    for number, film_of in crew.each(_shoot, [(todo[name].cell, protocol, crew) for name in names]):
        if not isinstance(film_of, Failure):
            write_atomically(todo[names[number]].gif, film_of)
            yield names[number]


def _shoot(cell: Cell, protocol: Protocol, crew: Crew) -> bytes:
    pictures = film(cell, protocol, crew.open_bank(protocol), crew.make_attacker)
    with tempfile.TemporaryDirectory() as folder:
        halves = [picture[TOP - 30 :, RIGHT - 8 :] for picture in pictures[::2]]
        return write_gif(halves, Path(folder) / "film.gif", fps=FPS).read_bytes()
