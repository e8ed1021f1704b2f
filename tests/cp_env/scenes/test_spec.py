"""Scenes named by a string: what is read out of it, and how options get their types."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cp_env.scenes import SOURCES, open_source
from cp_env.scenes.spec import PathSpec


def test_a_string_by_hand() -> None:
    spec = PathSpec.parse("opv2v:/data/C:drive?split=test&skip&noise=0.2")
    assert (spec.kind, spec.path) == ("opv2v", "/data/C:drive"), "a path may hold a colon"
    assert spec.options == {"split": "test", "skip": "", "noise": "0.2"}


@pytest.mark.parametrize("text", ["", "town", "town:", ":path", "town:?split=test"])
def test_a_kind_and_a_path_are_needed(text: str) -> None:
    with pytest.raises(ValueError, match="kind:path"):
        PathSpec.parse(text)


def opened(path: str, *, n: int = 1, share: float | None = None, on: bool = False, names: tuple[str, ...] = ()) -> Any:
    return path, n, share, on, names


def test_options_are_converted_to_the_types_of_the_factory() -> None:
    assert PathSpec.parse("kind:here?n=3&share=0.25&on&names=a,b").open(opened) == ("here", 3, 0.25, True, ("a", "b"))
    assert PathSpec.parse("kind:here?on=No&names=").open(opened) == ("here", 1, None, False, ())
    assert [PathSpec.parse(f"kind:here?on={word}").open(opened)[3] for word in ("1", "yes", "TRUE", "0")] == [
        1,
        1,
        1,
        0,
    ]


def test_a_class_is_a_factory_too() -> None:
    class Source:
        def __init__(self, path: str, *, folder: Path = Path()) -> None:
            self.path, self.folder = path, folder

    assert PathSpec.parse("kind:here?folder=a/b").open(Source).folder == Path("a/b")


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("n=many", "n must be a whole number, not 'many'"),
        ("on=perhaps", "on must be true or false, not 'perhaps'"),
        ("path=there", "unknown option of kind scenes 'path'.*known: n, share, on, names"),
    ],
)
def test_what_does_not_fit_is_told(query: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PathSpec.parse(f"kind:here?{query}").open(opened)


@pytest.mark.parametrize("kind", sorted(SOURCES))
@pytest.mark.parametrize("path", ["x" * 300, "/tmp/" + "y/" * 3000, "\udce4" * 300], ids=["name", "path", "surrogates"])
def test_a_path_that_no_file_system_takes(kind: str, path: str) -> None:
    if kind == "sumo":
        pytest.importorskip("libsumo", reason="needs the extra sumo")
    with pytest.raises(ValueError, match=r".+"):  # each source has words of its own
        open_source(f"{kind}:{path}")
