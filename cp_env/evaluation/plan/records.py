"""Results on disk: a JSON file with a checksum for each run, written whole or not at all."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from cp_env.evaluation.plan.checksum import UNLIKE, UNREADABLE, Broken, Fault, stamp, verify, versions, warn_of
from cp_env.evaluation.plan.driving_record import MAX_COUNT, DrivingRecord
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.metrics.average_precision import ApMeter
from cp_env.scenes.formats.bounded import read_bytes
from defenders.failure import Failure

IOUS = (0.5, 0.7)

RECORD_BYTES = 16 << 20
"""The file of a run is at most so long."""

MAX_BOXES = 10_000_000
"""Boxes or frames of an episode, at most."""


class PooledApMeter(ApMeter):
    """An AP meter of several episodes: the matches, without the frames they came from."""

    def __init__(
        self,
        scores: Float[np.ndarray, " D"],
        hits: Mapping[float, Bool[np.ndarray, " D"]],
        n_truth: int,
        n_frames: int,
        protocol: str = "strict",
    ) -> None:
        super().__init__(hits, protocol)
        self.n_truth, self.n_frames = n_truth, n_frames
        self._matched = {iou: (scores, hit) for iou, hit in hits.items()}

    @classmethod
    def pool(cls, meters: Sequence[ApMeter]) -> PooledApMeter:
        """One meter of several episodes.

        Raises:
            ValueError: they count by different AP protocols.
        """
        protocols = {meter.protocol for meter in meters}
        if len(protocols) != 1:
            raise ValueError(f"meters of different AP protocols do not merge: {sorted(protocols)}")
        matched = {iou: [meter.matched(iou) for meter in meters] for iou in meters[0].thresholds}
        hits = {iou: np.concatenate([hit for _, hit in parts]) for iou, parts in matched.items()}
        scores = np.concatenate([score for score, _ in matched[meters[0].thresholds[0]]])
        n_truth, n_frames = sum(m.n_truth for m in meters), sum(m.n_frames for m in meters)
        return cls(scores, hits, n_truth, n_frames, *protocols)

    def merge(self, other: ApMeter) -> PooledApMeter:
        return PooledApMeter.pool([self, other])

    def matched(self, iou: float) -> tuple[Float[np.ndarray, " D"], Bool[np.ndarray, " D"]]:
        return self._matched[iou]


@dataclass(frozen=True, eq=False)
class Record:
    """One episode: one scene of a run. Lists run over its frames, grace frames included."""

    scene: str
    attackers: tuple[int, ...]
    n_maps: int
    grace_frames: int
    meter: ApMeter  # of the output, at 0.5 and 0.7
    damage: tuple[float, ...]
    similarity: tuple[float, ...]
    verifications: tuple[int, ...]
    suspects: tuple[int, ...]  # when the defender first said it had converged, else in the last frame
    converged: int | None  # the frame in which it first did
    error: str | None  # why the defender failed, which ended the episode
    seconds: float  # its share of the time the world's steps took: perceiving and defending, not attacking
    informed: bool = False  # whether the world showed the defender the attackers: such a one is never ranked
    driving: DrivingRecord | None = None
    critical_meter: ApMeter | None = None  # of the output over critical vehicles, at 0.5
    failure: Failure | None = None  # what the error says, with its traceback; not stored

    def to_json(self) -> dict[str, Any]:
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name in _KINDS}
        return {
            **plain,
            "boxes": _pack_meter(self.meter, IOUS),
            "driving": self.driving and self.driving.to_json(),
            "critical_boxes": self.critical_meter and _pack_meter(self.critical_meter, IOUS[:1]),
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Record:
        """The record that `to_json` gave.

        Raises:
            ValueError, LookupError, TypeError, AttributeError, OverflowError, zlib.error: it is none.
        """
        plain: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items()}
        boxes, driving, critical = (plain.pop(name) for name in ("boxes", "driving", "critical_boxes"))
        if plain.keys() != _KINDS.keys() or not all(_is(value, *_KINDS[key]) for key, value in plain.items()):
            raise ValueError("values of a record that are missing, too many, or of another type")
        _check_ranges(**plain)
        n_frames, n_maps = len(plain["damage"]), plain["n_maps"]
        return cls(
            meter=_unpack_meter(boxes, IOUS),
            driving=None if driving is None else DrivingRecord.from_json(driving, n_frames, n_maps),
            critical_meter=None if critical is None else _unpack_meter(critical, IOUS[:1]),
            **plain,
        )


_KINDS: dict[str, tuple[type, ...]] = {
    "scene": (str,),
    "attackers": (tuple, int),
    "n_maps": (int,),
    "grace_frames": (int,),
    "damage": (tuple, float),
    "similarity": (tuple, float),
    "verifications": (tuple, int),
    "suspects": (tuple, int),
    "converged": (int, type(None)),
    "error": (str, type(None)),
    "seconds": (float,),
    "informed": (bool,),
}
"""Types of a record's values; behind `tuple`, that of its items."""


def _check_ranges(
    *,
    attackers: tuple[int, ...],
    n_maps: int,
    grace_frames: int,
    damage: tuple[float, ...],
    similarity: tuple[float, ...],
    verifications: tuple[int, ...],
    suspects: tuple[int, ...],
    converged: int | None,
    seconds: float,
    **_: Any,
) -> None:
    """ValueError unless each value of a record lies where such a value can lie."""
    named = (*attackers, *suspects)
    lawful = (
        all(0 <= share <= 1 for share in (*damage, *similarity))
        and all(0 <= count <= MAX_COUNT for count in (n_maps, grace_frames, *verifications))
        and all(0 <= vehicle < n_maps for vehicle in named)
        and (converged is None or 0 <= converged < len(damage))
        and 0 <= seconds < math.inf
    )
    if not lawful:
        raise ValueError("values of a record that no episode has")


def _is(value: Any, kind: type, other: type | None = None) -> bool:
    """Whether a value is of a kind or the other; or is a tuple whose items are of the other."""
    if kind is tuple:
        return type(value) is tuple and all(type(item) is other for item in value)
    return type(value) in (kind, other)


class Store:
    """A directory of finished runs, played with the detector whose digest is given."""

    def __init__(self, root: str | Path, detector: str = "") -> None:
        self.root, self.detector = Path(root), detector

    @property
    def folder(self) -> Path:
        """Where the runs' files are."""
        return self.root / "runs"

    def path(self, run: Run, conditions: Conditions) -> Path:
        return self.folder / f"{run.slug(conditions, self.detector)}.json"

    def write(self, run: Run, conditions: Conditions, records: Iterable[Record]) -> None:
        """Write a run atomically: a reader sees the whole run or none. The file holds its conditions, too.

        Raises:
            CannotWrite: the disk is full, the folder is read-only, or something stands in the file's place.
        """
        path = self.path(run, conditions)
        content = {
            **asdict(run),
            "conditions": conditions.describe(),
            "detector": self.detector,
            "identity": run.identity(conditions, self.detector),
            "made_with": versions(),
            "records": [record.to_json() for record in records],
        }
        write_atomically(path, stamp(path.stem, content))

    def examine(self, run: Run, conditions: Conditions) -> tuple[Record, ...] | Fault | None:
        """The run's episodes; None if it was not finished; what is wrong with its file if that cannot be used."""
        path = self.path(run, conditions)
        try:
            text = read_bytes(path, RECORD_BYTES)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError):
            return Fault(path, UNREADABLE)
        try:
            content = verify(text, path.stem)
        except Broken as error:
            return Fault(path, str(error))
        try:
            records = tuple(Record.from_json(record) for record in content["records"])
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError, zlib.error):
            return Fault(path, UNLIKE)
        return records if _of_run(records, run, conditions) else Fault(path, UNLIKE)

    def read(self, run: Run, conditions: Conditions) -> tuple[Record, ...] | None:
        """The run's episodes; None if it was not finished, or its file cannot be used, which is a warning."""
        return self.load([run], conditions).get(run)

    def load(self, runs: Iterable[Run], conditions: Conditions) -> dict[Run, tuple[Record, ...]]:
        """All of `runs` that are finished. Files that cannot be used are not counted; one warning a kind names them."""
        found = {run: self.examine(run, conditions) for run in runs}
        warn_of([fault for fault in found.values() if isinstance(fault, Fault)])
        return {run: records for run, records in found.items() if isinstance(records, tuple)}


def _of_run(records: Sequence[Record], run: Run, conditions: Conditions) -> bool:
    """Whether these are the episodes of that run: each scene once, in order, with its attackers and its frames."""
    return tuple(record.scene for record in records) == run.names and all(
        len(set(record.attackers)) == len(record.attackers) == run.k
        and record.n_maps == conditions.n_vehicles + int(conditions.rsu)
        and record.grace_frames == conditions.grace_frames
        and record.meter.protocol == conditions.ap
        and 1 <= len(record.damage) <= conditions.frames
        and len(record.damage) == len(record.similarity) == len(record.verifications)
        for record in records
    )


def _pack_meter(meter: ApMeter, ious: Sequence[float]) -> dict[str, Any]:
    """What a meter has matched at these thresholds, fit for JSON."""
    scores = meter.matched(ious[0])[0].astype(np.float32)
    hits = {str(iou): _pack(np.packbits(meter.matched(iou)[1])) for iou in ious}
    counts = {"n_truth": meter.n_truth, "n_frames": meter.n_frames, "n_boxes": len(scores)}
    return {**counts, "protocol": meter.protocol, "scores": _pack(scores), "hits": hits}


def _unpack_meter(boxes: dict[str, Any], ious: Sequence[float]) -> PooledApMeter:
    """The meter that `_pack_meter` was given; raises as `Record.from_json`."""
    n_truth, n_frames, n_boxes = (boxes[name] for name in ("n_truth", "n_frames", "n_boxes"))
    if not all(type(n) is int and 0 <= n <= MAX_BOXES for n in (n_truth, n_frames, n_boxes)):
        raise ValueError(f"counts of boxes and frames must be whole numbers up to {MAX_BOXES}")
    scores = _unpack(boxes["scores"], np.float32, n_boxes).astype(np.float64)
    packed = {iou: _unpack(boxes["hits"][str(iou)], np.uint8, -(-n_boxes // 8)) for iou in ious}
    hits = {iou: np.unpackbits(bits, count=n_boxes).astype(bool) for iou, bits in packed.items()}
    return PooledApMeter(scores, hits, n_truth, n_frames, boxes["protocol"])


def _pack(array: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(array.tobytes())).decode()


def _unpack(text: str, dtype: type[np.generic], count: int) -> np.ndarray:
    """ValueError unless these are so many numbers; no more than those are unpacked."""
    size = count * np.dtype(dtype).itemsize
    data = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), size + 1)
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes of numbers, not {size}")
    return np.frombuffer(data, dtype)
