"""An episode as pictures."""

from __future__ import annotations

from dataclasses import replace

from cp_env.bank import SceneBank
from cp_env.camera import Camera
from cp_env.evaluation.cells import Cell, Protocol, parse
from cp_env.evaluation.runner import MakeAttacker
from cp_env.evaluation.stage import Stage
from cp_env.rendering import Image3


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
