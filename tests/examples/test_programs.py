"""Every program of `examples/` starts as the pages start it: as a script, from any folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"

START_EACH = """
import contextlib, io, os, runpy, sys

elsewhere = [place for place in sys.path if place and os.path.realpath(place) != os.getcwd()]
for program in sys.argv[1:]:
    for name in [name for name in sys.modules if name.partition(".")[0] == "examples"]:
        del sys.modules[name]
    sys.path[:] = [os.path.dirname(program), *elsewhere]  # what Python does for a script
    sys.argv = [program, "--help"]
    shown, ending = io.StringIO(), "no help"
    with contextlib.redirect_stdout(shown):
        try:
            runpy.run_path(program, run_name="__main__")
        except SystemExit as stop:
            ending = stop.code
        except Exception as error:
            ending = repr(error)
    if ending != 0 or "usage" not in shown.getvalue().lower():
        print(program, ending)
"""
"""One process for all of them: most of the time goes into importing torch."""


def test_every_program_shows_its_help_as_a_script_from_another_folder(tmp_path: Path) -> None:
    programs = [str(file) for file in sorted(EXAMPLES.rglob("*.py")) if "__main__" in file.read_text(encoding="utf-8")]
    assert len(programs) > 30
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", START_EACH, *programs],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr
    assert not list(tmp_path.iterdir())
