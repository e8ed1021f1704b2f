"""Results on disk: one JSON file a run, written whole or not at all, so that a killed execution loses one run."""

from __future__ import annotations

import base64
import json
import os
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from cp_env.evaluation.plan.runs import Conditions, Run
from cp_env.metrics.average_precision import ApMeter

IOUS = (0.5, 0.7)


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

    def to_json(self) -> dict[str, Any]:
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "meter"}
        scores = self.meter.matched(IOUS[0])[0].astype(np.float32)
        hits = {str(iou): _pack(np.packbits(self.meter.matched(iou)[1])) for iou in IOUS}
        counts = {"n_truth": self.meter.n_truth, "n_frames": self.meter.n_frames, "n_boxes": len(scores)}
        return {**plain, "boxes": {**counts, "protocol": self.meter.protocol, "scores": _pack(scores), "hits": hits}}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Record:
        plain: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items()}
        boxes: dict[str, Any] = plain.pop("boxes")
        scores = _unpack(boxes["scores"], np.float32).astype(np.float64)
        hits = {
            iou: np.unpackbits(_unpack(boxes["hits"][str(iou)], np.uint8), count=boxes["n_boxes"]).astype(bool)
            for iou in IOUS
        }
        protocol = boxes.get("protocol", "strict")
        return cls(meter=PooledApMeter(scores, hits, boxes["n_truth"], boxes["n_frames"], protocol), **plain)


class Store:
    """A directory of finished runs, played with the detector whose digest is given."""

    def __init__(self, root: str | Path, detector: str = "") -> None:
        self.root, self.detector = Path(root), detector

    def path(self, run: Run, conditions: Conditions) -> Path:
        return self.root / "runs" / f"{run.slug(conditions, self.detector)}.json"

    def write(self, run: Run, conditions: Conditions, records: Iterable[Record]) -> None:
        """Write a run atomically: a reader sees the whole run or none. The file holds its conditions, too."""
        described = {"conditions": conditions.describe(), "detector": self.detector}
        data = {**asdict(run), **described, "records": [record.to_json() for record in records]}
        write_atomically(self.path(run, conditions), json.dumps(data) + "\n")

    def read(self, run: Run, conditions: Conditions) -> tuple[Record, ...] | None:
        """The run's episodes; None if it was not finished (a file that cannot be read counts as not finished)."""
        try:
            data = json.loads(self.path(run, conditions).read_text())
            return tuple(Record.from_json(record) for record in data["records"])
        except (OSError, ValueError, KeyError, TypeError, zlib.error):
            return None

    def load(self, runs: Iterable[Run], conditions: Conditions) -> dict[Run, tuple[Record, ...]]:
        """All of `runs` that are finished."""
        found = ((run, self.read(run, conditions)) for run in runs)
        return {run: records for run, records in found if records is not None}


def write_atomically(path: Path, data: str | bytes) -> None:
    """Write a file under another name, then rename it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_bytes(data.encode() if isinstance(data, str) else data)
    draft.replace(path)


def _pack(array: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(array.tobytes())).decode()


def _unpack(text: str, dtype: type[np.generic]) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype)
