"""Whether the tests catch mistakes: each mutant of the catalogue is put into a copy of the tree, and its tests are run.

    python -m tests.mutants.run [--only NAME ...] [--workers N]

A mutant is *killed* if one of its tests fails, and has *survived* if all of them pass. The tests must pass without it.
Results are kept in `out/mutants/results.jsonl`. One stands as long as the mutant, its file and its tests are the same,
so an interrupted run goes on. The exit status is 1 unless every mutant is killed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from tests.mutants.catalogue import CATALOGUE
from tests.mutants.mutant import Mutant

ROOT = Path(__file__).parents[2]
PACKAGES = ("cp_env", "defenders", "agents")
PLUGINS = ("tests.mutants.without_shrinking",)
PASSED, FAILED = 0, 1  # exit statuses of pytest
KILLED, SURVIVED, NOT_APPLICABLE, BROKEN = "killed", "survived", "not applicable", "broken"


@dataclass(frozen=True)
class Args:
    """Options of the program."""

    only: tuple[str, ...] = ()
    """names of mutants; all by default"""
    workers: int = 1
    """copies of the tree that are tested at the same time"""
    timeout: float = 600.0
    """seconds after which the tests of a mutant count as failed"""
    again: bool = False
    """forget earlier results of these mutants"""
    out: Path = ROOT / "out/mutants"
    """folder of the results"""


@dataclass(frozen=True)
class Result:
    """What became of a mutant. `key` changes with the mutant, its file and its tests."""

    name: str
    state: str
    seconds: float
    caught_by: str
    key: str


class BrokenTreeError(RuntimeError):
    """The copy is not what was to be tested: foreign packages, or tests that fail without a mutant."""


class Copy:
    """A copy of the tree in which one mutant at a time is applied."""

    def __init__(
        self,
        source: Path,
        folder: Path,
        *,
        packages: Sequence[str] = PACKAGES,
        plugins: Sequence[str] = PLUGINS,
        timeout: float = 600.0,
    ) -> None:
        """Copy the files that git knows or would add.

        Args:
            source: root of the tree.
            folder: where the copy is made; it must not exist.
            packages: packages that must be imported from the copy.
            plugins: modules that pytest loads first.
            timeout: seconds that a run of tests may take.

        Raises:
            BrokenTreeError: the packages are imported from elsewhere, as from an editable installation.
        """
        self.folder, self.plugins, self.timeout, self.written = folder, plugins, timeout, 0
        for name in listed(source):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source / name, folder / name)
        found = self._python("-c", f"import {', '.join(packages)}\nfor p in {', '.join(packages)},: print(p.__file__)")
        files = [Path(line).resolve() for line in found.stdout.split()]
        if len(files) != len(packages) or not all(file.is_relative_to(folder.resolve()) for file in files):
            raise BrokenTreeError(f"the copy must import its own {packages}, not {files}\n{found.stderr}")

    def test(self, tests: Sequence[str]) -> tuple[int, str]:
        """Run tests up to the first failure. Returns the exit status of pytest and the lines that say what failed."""
        plugins = [part for name in self.plugins for part in ("-p", name)]
        try:
            run = self._python("-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *plugins, *tests)
        except subprocess.TimeoutExpired:
            return FAILED, f"more than {self.timeout:.0f} s"
        failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return run.returncode, "; ".join(failed) or run.stdout[-2000:] + run.stderr[-2000:]

    @contextmanager
    def mutated(self, mutant: Mutant) -> Iterator[None]:
        """Apply the mutant, and restore the file. ValueError where it does not apply."""
        path = self.folder / mutant.file
        original = path.read_text(encoding="utf-8")
        self._write(path, mutant.applied(original))
        try:
            yield
        finally:
            self._write(path, original)

    def _write(self, path: Path, text: str) -> None:
        """Byte code is told apart by whole seconds and the size of the file, so every text gets a second of its own."""
        path.write_text(text, encoding="utf-8")
        self.written += 1
        os.utime(path, (self.written, self.written))

    def _python(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
        environment |= {"PYTHONPATH": str(self.folder), "OMP_NUM_THREADS": "1"}
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=self.timeout,
            check=False,
        )


def listed(source: Path) -> list[str]:
    """Files that are tracked, or neither tracked nor ignored."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=source, capture_output=True, text=True, check=True).stdout.split("\0")
    return sorted(name for name in set(names) - {""} if (source / name).is_file())


def key_of(mutant: Mutant, folder: Path) -> str:
    """A hash of the mutant, the file that it changes and the files of its tests."""
    digest = hashlib.sha256(repr(mutant).encode())
    for name in (mutant.file, *sorted({test.partition("::")[0] for test in mutant.tests})):
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()[:16]


def try_mutant(copy: Copy, mutant: Mutant) -> Result:
    """Put the mutant into the copy and run its tests."""
    start, key = time.monotonic(), key_of(mutant, copy.folder)
    try:
        with copy.mutated(mutant):
            status, said = copy.test(mutant.tests)
    except ValueError as error:
        return Result(mutant.name, NOT_APPLICABLE, 0.0, str(error), key)
    state = {PASSED: SURVIVED, FAILED: KILLED}.get(status, BROKEN)
    return Result(mutant.name, state, round(time.monotonic() - start, 1), "" if state == SURVIVED else said, key)


def check_green(copy: Copy, mutants: Sequence[Mutant]) -> None:
    """Run the tests of the mutants on the tree as it is. BrokenTreeError if one fails: it would kill any mutant."""
    tests = sorted({test for mutant in mutants for test in mutant.tests})
    status, said = copy.test(tests) if tests else (PASSED, "")
    if status != PASSED:
        raise BrokenTreeError(f"tests must pass without a mutant: {said}")


def try_all(copies: Sequence[Copy], mutants: Sequence[Mutant], take: Callable[[Result], object]) -> None:
    """Try every mutant, each in a copy that is free, and hand every result to `take` when it is there."""
    free: SimpleQueue[Copy] = SimpleQueue()
    for copy in copies:
        free.put(copy)

    def one(mutant: Mutant) -> Result:
        copy = free.get()
        try:
            return try_mutant(copy, mutant)
        finally:
            free.put(copy)

    with ThreadPoolExecutor(len(copies)) as pool:
        for done in as_completed([pool.submit(one, mutant) for mutant in mutants]):
            take(done.result())


def read_results(file: Path) -> dict[tuple[str, str], Result]:
    """Results of earlier runs by name and key; the last of equals. A line that was cut off is left out."""
    results = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            result = Result(**json.loads(line))
        except (json.JSONDecodeError, TypeError):
            continue
        results[result.name, result.key] = result
    return results


def chosen(only: Sequence[str]) -> list[Mutant]:
    """The mutants of these names; all if there is no name. ValueError for a name that is not known."""
    names = {mutant.name for mutant in CATALOGUE}
    if unknown := sorted(set(only) - names):
        raise ValueError(f"no such mutants: {', '.join(unknown)}; the names are in tests/mutants/rooms")
    return [mutant for mutant in CATALOGUE if not only or mutant.name in only]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program. Returns its exit status."""
    args = tyro.cli(Args, args=argv, description=__doc__)
    console, start = Console(), time.monotonic()
    mutants = chosen(args.only)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "results.jsonl"
    with tempfile.TemporaryDirectory(prefix="cp-env-mutants-") as folder:
        copies = [Copy(ROOT, Path(folder) / str(i), timeout=args.timeout) for i in range(args.workers)]
        earlier = {} if args.again else read_results(file)
        results = [earlier.get((mutant.name, key_of(mutant, copies[0].folder))) for mutant in mutants]
        known = [result for result in results if result is not None and result.state in (KILLED, SURVIVED)]
        names = {result.name for result in known}
        rest = [mutant for mutant in mutants if mutant.name not in names]
        console.print(f"{len(known)} known, {len(rest)} to try; their tests come first without a mutant")
        check_green(copies[0], rest)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console) as bars, file.open("a", encoding="utf-8") as lines:
            task = bars.add_task("mutants", total=len(rest))

            def take(result: Result) -> None:
                lines.write(json.dumps(asdict(result)) + "\n")
                lines.flush()
                known.append(result)
                bars.update(task, advance=1)
                if result.state != KILLED:
                    console.print(f"[bold red]{result.state}[/] {result.name} {result.caught_by}", highlight=False)

            try_all(copies, rest, take)
    for state in (KILLED, SURVIVED, NOT_APPLICABLE, BROKEN):
        these = sorted(result.name for result in known if result.state == state)
        if these:
            console.print(f"{state}: {len(these)}" + ("" if state == KILLED else f" ({', '.join(these)})"))
    console.print(f"{time.monotonic() - start:.0f} s")
    return 0 if all(result.state == KILLED for result in known) else 1


if __name__ == "__main__":
    sys.exit(main())
