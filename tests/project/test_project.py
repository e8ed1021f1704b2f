"""The project's own promises: what importing costs, what is packaged, which way imports point."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("cp_env", "defenders", "agents")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def python(code: str) -> str:
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


@pytest.mark.parametrize("package", ["cp_env", "defenders"])
def test_import_loads_no_torch(package: str) -> None:
    assert python(f"import sys, {package}; print('torch' in sys.modules)") == "False"


def test_the_arenas_workers_draw_nothing() -> None:
    """Every worker imports the program; pictures are drawn by its parent, at the end."""
    assert python("import sys, agents.arena.cli; print('matplotlib' in sys.modules)") == "False"


def test_importing_every_defender_loads_neither_torch_nor_the_world() -> None:
    code = """
import importlib, pkgutil, sys, defenders
for module in pkgutil.walk_packages(defenders.__path__, "defenders."):
    importlib.import_module(module.name)
print(sorted({"torch", "cp_env", "agents", "gymnasium"} & set(sys.modules)))
"""
    assert python(code) == "[]"


def test_importing_cp_env_is_cheap_next_to_gymnasium_and_pettingzoo() -> None:
    code = """
import time, gymnasium, pettingzoo
start = time.perf_counter()
import cp_env
print(time.perf_counter() - start)
"""
    best = min(float(python(code)) for _ in range(3))
    assert best <= 0.1, f"import cp_env adds {best:.3f} s"


def test_every_folder_of_modules_is_packaged() -> None:
    """What has modules has an `__init__`, and the patterns of `packages.find` take it along."""
    patterns = PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    for name in PACKAGES:
        for folder in {file.parent for file in (ROOT / name).rglob("*.py")}:
            assert (folder / "__init__.py").is_file(), f"{folder.relative_to(ROOT)} has no __init__.py"
            dotted = ".".join(folder.relative_to(ROOT).parts)
            assert any(fnmatchcase(dotted, pattern) for pattern in patterns), dotted


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_are_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()


def test_data_files_are_packaged_and_small() -> None:
    """Every file in a package that is no Python matches a package-data pattern; 16 MB at most in all."""
    total = 0
    for package in PACKAGES:
        patterns = PROJECT["tool"]["setuptools"]["package-data"][package]
        shipped = {file for pattern in patterns for file in (ROOT / package).glob(pattern)}
        for file in (ROOT / package).rglob("*"):
            if file.is_file() and file.suffix not in {".py", ".pyc"}:
                assert file in shipped, f"{file.relative_to(ROOT)} would not be in the wheel"
                total += file.stat().st_size
    assert total < 16e6


def test_constraints_pin_every_dependency() -> None:
    """One exact version each, with no local label: `torch==2.13.0+cpu` is on no public index."""
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9a-z.]*", line) for line in lines)

    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lines}
    wanted = list(PROJECT["project"]["dependencies"])
    for extra in PROJECT["project"]["optional-dependencies"].values():
        wanted += extra
    assert {re.split(r"[><=]", name)[0] for name in wanted} <= pinned


def library_files() -> list[Path]:
    return [file for name in PACKAGES for file in sorted((ROOT / name).rglob("*.py"))]


@pytest.mark.parametrize("file", library_files(), ids=lambda file: str(file.relative_to(ROOT)))
def test_library_code_is_portable(file: Path) -> None:
    """Nothing prints, nothing asks for CUDA by name, nothing draws from a global generator, no path is absolute."""
    tree = ast.parse(file.read_text())
    forked = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.With) and any("fork_rng" in ast.unparse(item) for item in node.items)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called != "print" or file.name == "cli.py", f"print in line {node.lineno}"
            assert not called.endswith(".cuda"), f".cuda() in line {node.lineno}"
            seeds = {"torch.manual_seed", "np.random.seed", "random.seed"}
            assert called not in seeds or node in forked, f"global seed in line {node.lineno}"
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            assert not re.match(r"/(home|root|work|tmp|usr|mnt)/", node.value), f"absolute path in line {node.lineno}"


def test_the_changelog_tells_of_this_version() -> None:
    assert f"## [{PROJECT['project']['version']}]" in (ROOT / "CHANGELOG.md").read_text()
