"""Play a plan: what is finished is skipped, the rest is played, and a cell that fails does not hold up the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cp_env.evaluation.execution.processes import Failure
from cp_env.evaluation.execution.rollout import open_defender, play
from cp_env.evaluation.execution.workers import Crew
from cp_env.evaluation.plan.grid import Turn
from cp_env.evaluation.plan.records import Record, Store
from cp_env.evaluation.plan.runs import Cell, Protocol, parse


class FailedCells(RuntimeError):
    """Some cells could not be played. All others were, and are stored; the next run tries these again."""

    def __init__(self, failed: Sequence[tuple[Cell, str]], n_cells: int) -> None:
        lines = (f"  {cell}: {why}" for cell, why in failed)
        super().__init__("\n".join([f"{len(failed)} of {n_cells} cells failed, all others are stored:", *lines]))
        self.failed = tuple(failed)


def prepare(cells: Sequence[Cell], protocol: Protocol, crew: Crew) -> Iterator[str]:
    """Encode every scene that the cache does not hold yet, and tell its name when it is there.

    Raises ValueError, before anything is encoded, for a defender or an attacker of the cells that cannot be made, and
    for a scene that cannot be encoded.
    """
    for defender in {cell.defender: None for cell in cells}:
        open_defender(defender)
    for attack in {cell.attack: None for cell in cells}:
        name, knobs = parse(attack)
        crew.make_attacker(name, **knobs)
    for number, done in crew.each(_encode, [(name, protocol, crew) for name in protocol.names]):
        if isinstance(done, Failure):
            raise ValueError(f"cannot encode scene {protocol.names[number]!r}: {done.reason}")
        yield done


def run(cells: Sequence[Cell], protocol: Protocol, store: Store, crew: Crew) -> Iterator[Cell]:
    """`run_all` for cells of one protocol."""
    for cell, *_ in run_all([(cell, protocol, store) for cell in cells], crew):
        yield cell


def run_all(turns: Sequence[Turn], crew: Crew) -> Iterator[Turn]:
    """Play the cells that their store does not hold, and hand out each turn when it is finished.

    Whatever ends the run, finished cells stay; run it again to go on. The figures do not depend on how often it was
    interrupted, nor on who plays.

    Raises FailedCells when all else is played, if a cell's defender, attacker or worker broke down.
    """
    todo = []
    for turn in turns:
        cell, protocol, store = turn
        if store.read(cell, protocol) is None:
            todo.append(turn)
        else:
            yield turn
    failed = []
    for number, done in crew.each(_play, [(cell, protocol, crew) for cell, protocol, _ in todo]):
        cell, protocol, store = todo[number]
        if isinstance(done, Failure):
            failed.append((cell, done.reason))
            continue
        store.write(cell, protocol, done)
        yield todo[number]
    if failed:
        raise FailedCells(failed, len(turns))


def _encode(name: str, protocol: Protocol, crew: Crew) -> str:
    crew.open_bank(protocol).episode(name, protocol.n_vehicles, protocol.rsu)
    return name


def _play(cell: Cell, protocol: Protocol, crew: Crew) -> list[Record]:
    name, knobs = parse(cell.attack)
    return play(cell, protocol, crew.open_bank(protocol), crew.make_attacker(name, **knobs), crew.clock)
