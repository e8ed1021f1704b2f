"""Defenders by name, by class and by factory."""

from __future__ import annotations

import contextlib
import sys
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import defenders
from defenders import Bayes, NoDefence, Prbi
from defenders.registry import Spec, checked_value, shown
from tests.campaign.values import STRANGE, Raising


def test_make_takes_names_objects_and_factories() -> None:
    assert isinstance(defenders.make("prbi", alpha=0.05), Prbi)
    finished = Prbi()
    assert defenders.make(finished) is finished
    assert isinstance(defenders.make(Prbi, alpha=0.05), Prbi)
    assert isinstance(defenders.make(lambda: Prbi(alpha=0.05)), Prbi)


def test_names_can_all_be_made() -> None:
    assert {"prbi", "none", "ego_only", "oracle"} <= set(defenders.names())
    for name in defenders.names():
        assert isinstance(defenders.make(name), defenders.Defender)


def test_an_unknown_name_lists_the_known_ones_and_the_nearest() -> None:
    with pytest.raises(ValueError, match=r"unknown defender 'pbri' .did you mean 'prbi'.*; known: prbi, robust_prbi"):
        defenders.make("pbri")


def test_bad_arguments() -> None:
    with pytest.raises(ValueError, match="unknown option of defender 'none' 'epsilon'"):
        defenders.make("none", epsilon=0.3)
    with pytest.raises(ValueError, match="takes no options"):
        defenders.make(Prbi(), epsilon=0.3)
    with pytest.raises(ValueError, match="built a dict"):
        defenders.make(dict)  # type: ignore[arg-type]


def test_the_grammar_by_hand() -> None:
    """A comma inside brackets and a colon inside a value end nothing; an attribute is a Python name."""
    for text, name, options in (
        ("prbi", "prbi", {}),
        ("prbi:threshold=calibrated,window=5", "prbi", {"threshold": "calibrated", "window": "5"}),
        ("robosac:ratios=(0.2,0.4),budget=3", "robosac", {"ratios": "(0.2,0.4)", "budget": "3"}),
        ("pgd:objective=remove@12.5:-3", "pgd", {"objective": "remove@12.5:-3"}),
        ("a.b:C", "a.b:C", {}),
        ("a.b:C:x=1,y=", "a.b:C", {"x": "1", "y": ""}),
    ):
        assert Spec.parse(text) == Spec(name, options), text


@pytest.mark.parametrize("text", ["prbi:=5", ":window=5", "prbi:a=1,a=2", "prbi:a b=1", "x" * 5000])
def test_what_the_grammar_does_not_hold_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"cannot read|at most 4096 characters"):
        Spec.parse(text)


@given(st.text(max_size=80))
def test_no_text_raises_anything_but_a_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        defenders.make(text)


@pytest.mark.parametrize(
    ("spec", "rule"),
    [
        ("prbi:epsilon=nan", "epsilon must be a finite number, not 'nan'"),
        ("prbi:epsilon=inf", "epsilon must be a finite number"),
        ("prbi:window=2.5", "window must be a whole number, not '2.5'"),
        ("prbi:rearm=perhaps", "rearm must be true or false"),
        ("prbi:widnow=5", "did you mean 'window'"),
        ("bayes:max_verifications=none", "max_verifications must be a whole number"),
        ("bayes:verifications=8", "unknown option of defender 'bayes' 'verifications'"),
        (f"prbi:threshold={'x' * 600}", "at most 512 characters"),
    ],
)
def test_values_are_read_by_type_and_refused_with_the_rule(spec: str, rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        defenders.make(spec)


@pytest.mark.parametrize(
    ("options", "rule"),
    [({"epsilon": float("nan")}, "finite"), ({"window": 2.5}, "whole number"), ({"window": True}, "whole number")],
)
def test_values_that_are_no_text_are_checked_alike(options: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        defenders.make("prbi", **options)


def test_text_and_keywords_build_the_same() -> None:
    by_text = defenders.make("bayes:max_verifications=8,certainty=0.95")
    by_keyword = defenders.make("bayes", max_verifications=8, certainty=0.95)
    assert isinstance(by_text, Bayes) and isinstance(by_keyword, Bayes)
    assert (by_text.max_verifications, by_text.certainty) == (8, 0.95)
    assert (by_keyword.max_verifications, by_keyword.certainty) == (8, 0.95)
    with pytest.raises(ValueError, match="given twice"):
        defenders.make("bayes:max_verifications=8", max_verifications=2)


def test_nothing_that_is_no_member_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    """`os:abort` would end the process; a function must say that it returns a member."""
    for place in ("os:abort", "sys:exit", "builtins:dict", "os:path", f"{__name__}:untyped"):
        with pytest.raises(ValueError, match=r"nothing was called|no defender"):
            defenders.make(place)
    monkeypatch.setitem(sys.modules, "plugins", SimpleNamespace(Own=Own, typed=typed, untyped=untyped))
    made = defenders.make("plugins:Own:level=3")
    assert isinstance(made, Own) and made.level == 3
    assert isinstance(defenders.make("plugins:typed"), Own)
    with pytest.raises(ValueError, match="nothing was called"):
        defenders.make("plugins:untyped")


class Own(NoDefence):
    def __init__(self, level: int = 1) -> None:
        self.level = level


def typed() -> NoDefence:
    return Own()


def untyped():  # type: ignore[no-untyped-def]
    raise AssertionError("this must not be called")


@pytest.mark.parametrize("width", [10, 80, 200])
def test_any_value_is_shown_in_a_few_characters(width: int) -> None:
    for make in STRANGE:
        assert 0 < len(shown(make(), width)) <= width


def test_what_is_short_is_shown_as_it_is() -> None:
    for value in ("text", 3, 0.5, None, True, [1, 2, 3], (0, 5), {"a": 1}, b"x"):
        assert shown(value) == repr(value)
    assert shown("x" * 1000, 20) == "'" + "x" * 18 + "…"
    assert shown(list(range(10**6)), 80).startswith("[0, 1, 2, 3, 4, 5, ")


def test_an_object_whose_repr_fails_is_shown_by_its_class() -> None:
    class Grim:
        def __repr__(self) -> str:
            raise RuntimeError("no")

    assert "Grim" in shown(Grim())


@pytest.mark.parametrize("kind", [int, float, bool, str])
def test_strange_values_are_of_a_kind_or_refused(kind: type) -> None:
    taken, refusals = [], []
    for make in STRANGE:
        try:
            taken.append(checked_value("x", make(), kind))
        except ValueError as error:
            refusals.append(str(error))
    assert taken and all(isinstance(value, kind) for value in taken)
    assert all(said.startswith("x must be ") and len(said) < 200 for said in refusals)
    with pytest.raises(ValueError, match="x must be a finite number, not <"):
        checked_value("x", Raising(), float)
