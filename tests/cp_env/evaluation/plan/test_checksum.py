"""The checksum sees every changed byte; the name sees every copy."""

from __future__ import annotations

import hashlib
import json
import random
from pathlib import Path

import pytest

from cp_env.evaluation.plan import checksum
from cp_env.evaluation.plan.checksum import Broken, Fault, StoredRunWarning, copies, stamp, verify, warn_of

CONTENT = {"a": [1, 2.5, None, "ä"], "b": {"c": True}}


def test_what_was_stamped_is_verified_and_is_plain_json() -> None:
    text = stamp("run-1", CONTENT)
    assert verify(text.encode(), "run-1") == CONTENT
    read = json.loads(text)
    digest = read.pop("checksum")
    assert read == {"name": "run-1", **CONTENT}
    assert digest == hashlib.sha256((json.dumps(read) + "\n").encode()).hexdigest()


def test_every_changed_byte_is_seen() -> None:
    text, rng = stamp("run-1", CONTENT).encode(), random.Random(0)
    for at in range(len(text)):
        for changed in (text[:at], text[:at] + bytes([text[at] ^ 1 << rng.randrange(8)]) + text[at + 1 :]):
            with pytest.raises(Broken, match=r"are empty|were cut or changed"):
                verify(changed, "run-1")


def forged(body: str) -> bytes:
    """A text with a checksum that fits, whatever is in it."""
    digest = hashlib.sha256(body.encode()).hexdigest()
    return f'{{"checksum": "{digest}", {body[1:]}'.encode()


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (b"", checksum.EMPTY),
        (b" \n", checksum.EMPTY),
        (b"{}", checksum.CHANGED),
        (json.dumps(CONTENT).encode(), checksum.CHANGED),
        (stamp("run-2", CONTENT).encode(), checksum.FOREIGN),
        (forged('{"name": "run-1", "a": ' + "[" * 100_000), checksum.UNLIKE),
        (forged('{"name": "run-1", "a": ' + "[" * 500 + "]" * 500 + "}"), checksum.UNLIKE),
        (forged('{"name": "run-1", "name": "run-1"}'), checksum.UNLIKE),
    ],
)
def test_what_is_wrong_is_named(text: bytes, kind: str) -> None:
    with pytest.raises(Broken) as caught:
        verify(text, "run-1")
    assert str(caught.value) == kind


def test_copies_are_seen_by_their_beginnings(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.json").write_text(stamp(name, CONTENT))
    (tmp_path / "a (copy).json").write_text(stamp("a", CONTENT))
    (tmp_path / "ab.json").write_text(stamp("a", CONTENT))
    (tmp_path / "old.json").write_text("{}")
    assert [fault.path.name for fault in copies(tmp_path, [tmp_path / "b.json"])] == [
        "a (copy).json",
        "ab.json",
        "old.json",
    ]
    assert copies(tmp_path / "nowhere", []) == []


def test_one_warning_a_kind() -> None:
    faults = [Fault(Path(f"runs/{i}.json"), checksum.EMPTY) for i in range(7)] + [
        Fault(Path("runs/x.json"), checksum.FOREIGN)
    ]
    with pytest.warns(StoredRunWarning) as caught:
        warn_of(faults)
    said = [str(warning.message) for warning in caught]
    assert len(said) == 2 and said[0].startswith("7 stored runs in runs are empty; they are not counted")
    assert "0.json, 1.json, 2.json, 3.json, 4.json, and 2 more" in said[0] and "x.json" in said[1]
