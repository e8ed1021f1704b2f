"""The sealed process, line by line, without a process: requests in, answers out."""

from __future__ import annotations

import json
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import pytest

from defenders import Defender, Frame, Inspection, Query, Verdict
from defenders.sealed.child import Server, generator_of
from defenders.sealed.proxy import described


def answers(*requests: dict[str, Any]) -> list[dict[str, Any]]:
    lines = "".join(json.dumps(request) + "\n" for request in requests)
    with TemporaryFile("w+") as requested, TemporaryFile("w+") as answered:
        requested.write(lines)
        requested.seek(0)
        Server(requested, answered).serve()
        answered.seek(0)
        return [json.loads(line) for line in answered]


class Twin(Defender):
    """Queries two groups and compares their views."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        del n_vehicles, rng

    def inspect(self, frame: Frame) -> Inspection:
        first, second = yield Query([[1, 0], [2]])
        return Verdict([0] if frame.similarity(first, second) < 0.5 else [0, 1])


def made(spec: str, **reset: Any) -> list[dict[str, Any]]:
    """The requests that make defender 1 and begin an episode of three vehicles."""
    rng = described(np.random.default_rng(3))
    return [
        {"op": "make", "number": 1, "spec": spec, "path": []},
        {"op": "reset", "number": 1, "n_vehicles": 3, "rng": rng, **reset},
    ]


INSPECT = {"op": "inspect", "number": 1, "index": 0, "n_vehicles": 3, "present": [0, 1, 2], "seen": 7}


def test_a_frame_gets_a_verdict_and_the_handles_that_are_still_held() -> None:
    make, reset, verdict = answers(*made("none"), INSPECT)
    assert make == {"informed": False, "max_queries": make["max_queries"]}
    assert reset == {}
    assert verdict["verdict"] == [[0, 1, 2], [], False]
    assert set(verdict["live"]) <= {7}


def test_a_query_is_groups_of_numbers_and_is_answered_by_handles() -> None:
    query, question = answers(*made(f"{__name__}:Twin"), INSPECT, {"op": "send", "number": 1, "views": [8, 9]})[2:4]
    assert query == {"query": [[0, 1], [2]], "verification": True}
    assert question == {"ask": ["similarity", 8, 9]}


def test_only_an_informed_class_says_so() -> None:
    assert answers(*made("oracle")[:1])[0]["informed"] is True


@pytest.mark.parametrize(
    ("requests", "error"),
    [
        (made("prbbi"), "ValueError: unknown defender 'prbbi'"),
        ([{"op": "nonsense"}], "AttributeError"),
        ([{**INSPECT, "number": 5}], "KeyError"),
    ],
    ids=["unknown", "no such request", "no such defender"],
)
def test_what_goes_wrong_is_an_answer_and_the_process_goes_on(requests: list[dict[str, Any]], error: str) -> None:
    first, *_, last = answers(*requests, {"op": "drop", "numbers": [1]})
    assert first["error"].startswith(error)
    assert last == {}


def test_a_generator_goes_on_where_the_described_one_stood() -> None:
    theirs = np.random.default_rng(5)
    theirs.spawn(2)
    theirs.random(7)
    ours = generator_of(json.loads(json.dumps(described(theirs))))
    assert ours.random() == theirs.random()
    assert ours.spawn(1)[0].random() == theirs.spawn(1)[0].random()
