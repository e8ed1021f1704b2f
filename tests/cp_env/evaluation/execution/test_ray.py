"""Runs on a Ray cluster."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.arena import make_attack
from cp_env.evaluation import Store, Workers, execute
from tests.helpers.toy_evaluation import CONDITIONS, RUNS, open_toy


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    workers = Workers(make_attack=make_attack, open_bank=open_toy, ray="")
    with pytest.raises(ImportError, match=r"pip install 'cp-env\[ray\]'"):
        list(execute(RUNS, CONDITIONS, Store(tmp_path), workers))
