"""Every snippet of the documentation runs, every command in it can be given, every table of options is true."""

from __future__ import annotations

import functools
import inspect
import re
import sys
import tomllib
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

import defenders
from agents.commands.train import COMMANDS
from cp_env import cli
from cp_env.scenes.export import export
from cp_env.settings import DEFAULTS
from cp_env.types import Detections
from tests.helpers import dair_sets, nuscenes_sets
from tests.helpers.coperception_files import write_files
from tests.helpers.pages import ROOT, accepts, blocks, commands, in_tests, pages, run_page
from tests.helpers.stand_in_town import Sketch
from tests.helpers.toy_scenes import ToySource
from tests.helpers.v2xsim_sets import Numbered, Thin
from tests.reference import coperception as twin

LIBRARIES = ("benchmarl", "rllib", "supersuit", "torchrl")
"""Their pages run in environments of their own: `make libraries`, tests/external/."""


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The town is a sketch, and the current folder an empty one."""
    monkeypatch.setattr("cp_env.scenes.Town", Sketch)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _v2x_sim(folder: Path) -> None:
    export(Thin(Numbered(1), 100), folder / "V2X-Sim-2.0")
    write_files(Numbered(1), folder / "V2X-Sim-det", "test", {"scene_0": 8, "scene_1": 96, "scene_5": 97})


def _opv2v(folder: Path) -> None:
    for name in ("OPV2V", "V2XSet"):
        export(Thin(ToySource(n_frames=1), 100), folder / name / "test", layout="opv2v")


def _dair_v2x(folder: Path) -> None:
    dair_sets.write_set(ToySource(n_frames=3), folder / "DAIR-V2X-C", every=100)


def _nuscenes(folder: Path) -> None:
    nuscenes_sets.write_set(ToySource(n_frames=1), folder / "nuscenes", ["scene-0061", "scene-0103"], every=100)


def _checkpoint(folder: Path) -> None:
    for fusion in ("v2vnet", "disconet"):
        (folder / fusion).mkdir()
        twin.save(twin.random_state(fusion), folder / fusion / "epoch_100.pth")


def _network(folder: Path) -> None:
    pytest.importorskip("libsumo", reason="needs the extra sumo")
    root = folder / "ingolstadt"
    root.mkdir()
    (root / "24h.sumocfg").write_text(
        '<configuration><input><net-file value="a.net.xml"/><route-files value="r.xml"/></input></configuration>'
    )
    (root / "a.net.xml").write_text("<net/>")
    (root / "r.xml").write_text("<routes/>")


DATA: dict[str, Callable[[Path], None]] = {
    "docs/coperception.md": _checkpoint,
    "docs/dair-v2x.md": _dair_v2x,
    "docs/nuscenes.md": _nuscenes,
    "docs/opv2v.md": _opv2v,
    "docs/scenes.md": _network,
    "docs/v2x-sim.md": _v2x_sim,
}
"""Pages that read files of the reader's own, under /data or in the current folder, and who writes small ones."""

BOX = Detections(np.array([[1.0, 2.0, 4.5, 1.8, 0.1]]), np.array([0.9]))
NAMES: dict[str, dict[str, Any]] = {
    "docs/average-precision.md": {"detections": [BOX], "truths": [BOX.boxes]},
    "docs/verification-counts.md": {
        "samples": {(size, k): [0.9 - 0.2 * k] for size in range(1, 6) for k in range(min(size, 4) + 1)}
    },
}
"""What a page takes for granted."""


@pytest.mark.parametrize(
    "page",
    [page for page in pages()[1:] if list(blocks(page, "python")) and Path(page).stem not in LIBRARIES],
)
def test_the_python_of_a_page_runs(page: str, sketched: Path) -> None:
    """Its blocks, in order, in one namespace, on a sketch of the town; a page's own assertions count."""
    DATA.get(page, lambda folder: None)(sketched)
    run_page(page, NAMES.get(page), {"/data/": f"{sketched}/"})


def test_pages_of_libraries_are_tested_elsewhere() -> None:
    targets = (ROOT / "Makefile").read_text()
    for name in LIBRARIES:
        assert list(blocks(f"docs/{name}.md", "python")) and name in targets
        assert f'"docs/{name}.md"' in (ROOT / f"tests/external/test_{name}.py").read_text()


def test_the_python_of_the_readme_runs(sketched: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = run_page("README.md")
    assert "verifications" in capsys.readouterr().out
    assert names["picture"].shape[2:] == (3,) and names["damage"] > 0
    env = names["env"]
    assert type(env.game.world.defenders[0]).__name__ == "Halves"
    env.reset(seed=0)
    while env.agents:
        env.step({agent: env.action_space(agent).high for agent in env.agents})


def test_numbers_for_the_tests() -> None:
    code = "a = 1\n    n = 5_000  # 3 min; 64 in the tests\nx = 2  # seconds\n"
    assert in_tests(code) == "a = 1\n    n = 64  # 3 min; \nx = 2  # seconds\n"
    for page in pages():
        for line, block in blocks(page, "python"):
            assert "in the tests" not in in_tests(block), (
                f"{page}, after line {line}: not of the form `n = 1  # … in the tests`"
            )


# -- commands --------------------------------------------------------------------------------------------------------


MAKE = {
    *re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE),
    *(f"library-{name}" for name in LIBRARIES),
}
EXTRAS = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])


@pytest.mark.parametrize("page", [page for page in pages() if list(commands(page))])
def test_the_commands_of_a_page_can_be_given(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs exist, and take the arguments given; nothing is run."""
    for name in ("scenes", "scenes_export", "scenes_preview", "play", "check", "version"):
        monkeypatch.setattr(cli, name, _silent(getattr(cli, name)))
    monkeypatch.setitem(sys.modules, "mine", _mine())
    for words in commands(page):
        _check(words)


def _mine() -> ModuleType:
    """The module that a reader was told to write, with the defender of that page."""
    module = ModuleType("mine")
    _, code = next(blocks("docs/write-your-own-defender.md", "python"))
    exec(code, module.__dict__)
    return module


def _silent(function: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(function)
    def nothing(*args: Any, **options: Any) -> None:
        del args, options

    return nothing


PROGRAMS = {
    "cp-arena": "agents.arena.cli",
    "cp-benchmark": "agents.commands.benchmark",
    "cp-calibrate": "agents.commands.calibrate",
    "cp-env evaluate": "cp_env.detector.training.evaluate",
    "cp-play": "agents.commands.play",
    **{f"cp-train {kind}": module for kind, module in COMMANDS.items()},
}
"""The module of each program whose options are its `Args`."""


def _check(words: list[str]) -> None:
    if program := next((p for p in PROGRAMS if words[: len(p.split())] == p.split()), None):
        accepts(import_module(PROGRAMS[program]).Args, words[len(program.split()) :])
        return
    match words:
        case ["make", target, *settings]:
            assert target in MAKE and all("=" in setting for setting in settings), words
        case ["python", "-m", "pytest", *given] | ["pytest", *given]:
            paths = [word for last, word in pairwise(["", *given]) if last != "-k" and not word.startswith("-")]
            assert paths and all((ROOT / path).exists() for path in paths), words
        case ["python", "-m", module, *given]:
            accepts(import_module(module).Args, given)
        case ["python", "-c", code]:
            compile(code, "-c", "exec")
        case ["python", file, *given]:
            accepts(import_module(file.removesuffix(".py").replace("/", ".")).Args, given)
        case ["cp-env", *given]:
            _given_to_cp_env(given)
        case ["pip" | ".venv/bin/pip", "install", *given]:
            extras = {extra for word in given for found in re.findall(r"\[(.*?)\]", word) for extra in found.split(",")}
            assert extras <= EXTRAS, words
        case ["tensorboard", "--logdir", _] | ["cd", _] | ["git", "clone", *_] | ["docker", "build" | "run", *_]:
            pass
        case _:
            raise AssertionError(f"an unknown program: {words}")


def _given_to_cp_env(given: list[str]) -> None:
    try:
        cli.main(given)
    except SystemExit as stop:
        if stop.code and not given[-1].startswith("--"):
            raise AssertionError(f"cannot be given: {given}") from stop
        if stop.code:
            _given_to_cp_env([*given, "0"])  # an option mentioned without its value


# -- tables and menu -------------------------------------------------------------------------------------------------


def options_of(page: str) -> dict[str, dict[str, str]]:
    """Defaults by option in every `| option | default | … |` table, under the table's nearest heading."""
    tables: dict[str, dict[str, str]] = {}
    heading = ""
    for line in (ROOT / page).read_text().splitlines():
        if line.startswith("#"):
            heading = line
        if found := re.match(r"\| `(\w+)` \| ([^|]+) \|", line):
            tables.setdefault(heading, {})[found[1]] = found[2].strip("` ")
    return tables


def _written(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(f"{one:g}" for one in value)
    return repr(value).replace("'", '"')


@pytest.mark.parametrize("name", [name for name in defenders.names() if name not in ("none", "ego_only", "oracle")])
def test_options_of_defenders(name: str) -> None:
    """docs/defenders.md names every option, with the default of the code."""
    told = options_of("docs/defenders.md")[f"## Options of `{name}`"]
    parameters = inspect.signature(defenders.DEFENDERS.factory(name)).parameters
    assert told == {option: _written(parameter.default) for option, parameter in parameters.items()}


def test_options_of_environments() -> None:
    """Every option of `parallel_env` is named on the page of its concept, with its true default."""
    defaults = {"defender": "prbi", **DEFAULTS}
    for page in ("docs/environments.md", "docs/threat-model.md", "docs/perception.md"):
        for option, told in next(iter(options_of(page).values())).items():
            assert told == ("none" if defaults[option] is None else _written(defaults[option])), option
    concepts = "".join(
        (ROOT / f"docs/{page}.md").read_text()
        for page in (
            "environments",
            "threat-model",
            "perception",
            "observations",
            "actions",
            "rewards",
            "defenders",
            "scenes",
        )
    )
    missing = [option for option in defaults if f"`{option}" not in concepts]
    assert not missing


def test_every_page_is_in_the_menu() -> None:
    """mkdocs.yml lists the pages under docs/, each once, and nothing else."""

    def leaves(menu: Any) -> list[str]:
        if isinstance(menu, str):
            return [menu]
        return [leaf for entry in (menu.values() if isinstance(menu, dict) else menu) for leaf in leaves(entry)]

    listed = leaves(yaml.load((ROOT / "mkdocs.yml").read_text(), yaml.BaseLoader)["nav"])
    assert sorted(f"docs/{leaf}" for leaf in listed) == [page for page in pages() if page != "README.md"]
