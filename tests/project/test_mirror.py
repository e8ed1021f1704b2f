"""The tree: each module has its tests at the mirrored path, and folders stay small where a newcomer begins."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

REASONS = {
    "*/protocol.py": "declarations; conformance tests hold implementations to them",
    "cp_env/types.py": "declarations",
    "cp_env/paths.py": "world/test_cache_folder.py",
    "cp_env/envs/core.py": "test_parallel, test_single and test_vector are views of it",
    "cp_env/envs/render_mixin.py": "test_parallel, test_single and test_vector",
    "cp_env/rendering/camera.py": "envs/test_parallel.py and evaluation/report/test_video.py",
    "cp_env/rendering/window.py": "envs/test_parallel.py",
    "cp_env/world/episode.py": "test_scene_cache.py and test_world.py, whose slow twin uses it",
    "cp_env/detector/model/base.py": "testing/test_detector.py, whose mutants derive from it",
    "cp_env/detector/model/encoder.py": "test_weights.py",
    "cp_env/detector/model/fingerprint.py": "test_weights.py",
    "cp_env/detector/model/fusion/base.py": "test_fusion.py, laws over the family",
    "cp_env/testing/cp_env_rules.py": "test_parallel_env.py: one loop over the mutants of both rule sets",
    "cp_env/testing/rollout.py": "test_parallel_env.py",
    "cp_env/scenes/export.py": "v2xsim/test_use.py and opv2v/test_writer.py",
    "cp_env/scenes/subset.py": "agents/learning/test_training.py",
    "cp_env/scenes/opv2v/files.py": "test_source.py",
    "cp_env/scenes/preview/tables.py": "test_film.py",
    "cp_env/scenes/v2xsim/build.py": "test_source.py",
    "cp_env/scenes/v2xsim/index.py": "test_source.py",
    "cp_env/scenes/v2xsim/indexing.py": "test_source.py",
    "cp_env/scenes/v2xsim/tabled.py": "test_source.py and nuscenes/test_source.py",
    "cp_env/scenes/v2xsim/preprocessed_build.py": "test_preprocessed.py",
    "cp_env/scenes/v2xsim/writer.py": "test_source.py: every test reads what it wrote",
    "cp_env/evaluation/analysis/results.py": "agents/arena/test_cli.py",
    "cp_env/evaluation/analysis/worst_episodes.py": "agents/arena/test_cli.py",
    "cp_env/evaluation/execution/processes.py": "test_workers.py",
    "cp_env/evaluation/report/html.py": "test_arena.py, in a browser too",
    "cp_env/evaluation/report/leaderboard.py": "agents/arena/test_cli.py",
    "cp_env/evaluation/report/plots.py": "test_arena.py",
    "defenders/checks.py": "refusals in each defender's tests",
    "agents/arena/*.py": "arena/test_cli.py: own classes, bad input, killed runs",
    "agents/commands/train_*.py": "commands/test_train.py and test_your_data.py",
    "agents/attacks/constraint.py": "test_gradient_options.py and cp_env/perturbation/test_ball.py",
    "agents/attacks/random_action.py": "test_gradient.py, laws over the family",
    "agents/attacks/registry.py": "test_gradient.py and defenders/test_registry.py: one grammar",
    "agents/attacks/spec.py": "test_gradient.py, refusals",
    "agents/attacks/objectives/untargeted.py": "test_gradient.py, laws over the family",
    "agents/learning/callbacks.py": "test_training.py, killed runs",
    "agents/learning/rollout.py": "test_policy.py",
}
"""Modules without a test file of their own, and where they are tested."""

MODULES = [
    file.relative_to(ROOT).as_posix()
    for package in ("cp_env", "defenders", "agents")
    for file in sorted((ROOT / package).rglob("*.py"))
    if file.name != "__init__.py"
]


def mirrored(module: str) -> Path:
    path = Path(module)
    return ROOT / "tests" / path.parent / f"test_{path.name}"


@pytest.mark.parametrize("module", MODULES)
def test_a_module_has_its_tests_where_its_path_says(module: str) -> None:
    known = any(fnmatchcase(module, pattern) for pattern in REASONS)
    assert mirrored(module).is_file() or known, f"write {mirrored(module).relative_to(ROOT)}, or say why not"


def test_every_reason_is_needed() -> None:
    for pattern in REASONS:
        assert any(fnmatchcase(module, pattern) and not mirrored(module).is_file() for module in MODULES), pattern


@pytest.mark.parametrize(("package", "most"), [("cp_env", 8), ("defenders", 8), ("agents", 6)])
def test_few_modules_stand_at_the_root(package: str, most: int) -> None:
    """Of `defenders`, two are defenders of one file each."""
    assert len(list((ROOT / package).glob("*.py"))) <= most


def test_no_file_is_long() -> None:
    for module in MODULES:
        lines = (ROOT / module).read_text().count("\n")
        assert lines <= 440, f"{module} has {lines} lines"
