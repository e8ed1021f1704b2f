"""The wheel does the job: installed alone, outside a clone, its programs run, and README and tutorial do."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

from tests.helpers.pages import blocks

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
HELPERS = ("pages", "stand_in_town", "toy_scenes")
PAGES = ("PACKAGE.md", "README.md", "docs/tutorial.md")

ALONE = """
import importlib.abc, sys
EXTRAS = {"stable_baselines3", "sb3_contrib", "tensorboard", "yaml", "sumolib", "libsumo", "traci", "ray", "shapely",
          "foolbox", "pandas", "beartype", "hypothesis", "pycocotools", "pytest"}

class Refuse(importlib.abc.MetaPathFinder):
    "What `pip install` alone does not bring."
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
"""

RUN_PAGES = """
import cp_env.scenes
from tests.helpers.pages import run_page
from tests.helpers.stand_in_town import Sketch

assert SITE in cp_env.__file__, cp_env.__file__
cp_env.scenes.Town = Sketch  # few frames behind each name
for page in PAGES:
    run_page(page)
    print("ran", page)
"""

HELP = """
from importlib.metadata import distribution

for script in distribution("cp-env").entry_points.select(group="console_scripts"):
    try:
        script.load()(["--help"])
    except SystemExit as stop:
        assert not stop.code, (script.name, stop.code)
    print("helped", script.name)
from agents.commands.train import main
try:
    main(["attack"])
except SystemExit as stop:
    print(stop)
try:
    import agents.sb3
except ImportError as error:
    print(error)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of what it is made of, so that nothing is left in the clone."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for package in ("cp_env", "defenders", "agents"):
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "LICENSE", PROJECT["readme"]):
        shutil.copy(ROOT / file, source / file)
    _pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(out), str(source))
    (built,) = out.glob("*.whl")
    return built


def _pip(*words: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *words]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel; its dependencies are those of this one, by a path."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    _pip("--python", str(python), "install", "--no-deps", "--no-index", str(wheel))
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")  # no .pth there is followed from here
    return folder


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder outside the clone, with the pages and what runs them."""
    folder = tmp_path_factory.mktemp("elsewhere")
    (folder / "tests/helpers").mkdir(parents=True)
    (folder / "docs").mkdir()
    for name in HELPERS:
        shutil.copy(ROOT / f"tests/helpers/{name}.py", folder / f"tests/helpers/{name}.py")
    for page in PAGES:
        shutil.copy(ROOT / page, folder / page)
    return folder


def run(installed: Path, elsewhere: Path, code: str) -> str:
    """What a program prints there."""
    head = f"{ALONE}\nSITE, PAGES = {str(installed)!r}, {PAGES!r}\n"
    done = subprocess.run(
        [installed / "bin/python", "-c", head + code],
        cwd=elsewhere,
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_every_block_of_readme_and_tutorial_runs_after_pip_install_alone(installed: Path, elsewhere: Path) -> None:
    told = run(installed, elsewhere, RUN_PAGES)
    assert all(f"ran {page}" in told for page in PAGES)


def test_every_program_is_there_and_helps(installed: Path, elsewhere: Path) -> None:
    """Without extras; what needs one says which."""
    told = run(installed, elsewhere, HELP)
    assert {line.removeprefix("helped ") for line in told.splitlines() if line.startswith("helped ")} == set(
        PROJECT["scripts"]
    )
    assert len(re.findall(r"pip install 'cp-env\[agents\]'", told)) >= 2, told
    for program in PROJECT["scripts"]:
        assert (installed / "bin" / program).is_file()
    version = subprocess.run([installed / "bin/cp-env", "--version"], cwd=elsewhere, capture_output=True, text=True)
    assert version.stdout.strip() == PROJECT["version"], version.stderr


def test_the_wheel_says_who_made_it_and_reads_well_elsewhere(wheel: Path) -> None:
    """No picture and no link that only a clone resolves; every extra that it names is one."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        about = Parser().parsestr(archive.read(name).decode())
    text = str(about.get_payload())
    assert about["Author"] == "The cp_env developers" and "collaborative perception" in about["Keywords"]
    assert not re.findall(r"\]\((?!https?://)", text) and "<img" not in text
    extras = set(PROJECT["optional-dependencies"])
    assert {extra for found in re.findall(r"cp-env\[(.*?)\]", text) for extra in found.split(",")} <= extras
    assert not any(re.search(r"<[^>]*repository", (ROOT / page).read_text()) for page in PAGES), "a placeholder"


def test_console_lines_of_readme_and_tutorial_name_programs_of_the_wheel() -> None:
    """But for those that say that they are run in a clone."""
    clone = {"pip", "make", "python"}
    for page in PAGES:
        for _, text in blocks(page, "sh"):
            for line in text.splitlines():
                program = line.split()[0]
                assert program in {*PROJECT["scripts"], *clone}, line
