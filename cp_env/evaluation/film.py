"""An episode as pictures."""

from __future__ import annotations

from cp_env.bank import SceneBank
from cp_env.camera import Camera
from cp_env.evaluation.cells import Cell, Protocol, parse
from cp_env.evaluation.runner import MakeAttacker
from cp_env.evaluation.stage import brief, open_world
from cp_env.rendering import Image3


def film(
    cell: Cell, protocol: Protocol, bank: SceneBank, make_attacker: MakeAttacker, frames: int | None = None
) -> list[Image3]:
    """The first scene of the cell, frame by frame, to its end or for `frames`."""
    cell = Cell(cell.defender, cell.attack, cell.k, cell.seed, cell.names[:1])
    name, knobs = parse(cell.attack)
    attacker, world = make_attacker(name, **knobs), open_world(cell, protocol, bank)
    brief(attacker, cell)
    camera, pictures = Camera(world), []
    while True:
        outcome = world.step(attacker.act(world.situation()))
        camera.watch(outcome)
        pictures.append(camera.shoot())
        if outcome.truncated[0] or len(pictures) == frames:
            return pictures
