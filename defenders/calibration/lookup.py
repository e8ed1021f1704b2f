"""Which calibration a defender rests on: the user's for the ego's weights, else the one that ships for them.

The detector is known by the digest of its weights, which is the ego's own and says nothing of an episode. Where no file
fits, the shipped one of the same fusion serves, and a warning says so, once.
"""

from __future__ import annotations

import os
import warnings
from functools import lru_cache
from pathlib import Path

from defenders.calibration.files import Calibration, read_calibration
from defenders.protocol import EgoFusion

SHIPPED = Path(__file__).with_name("shipped")
DEFAULT = "mean"
"""The fusion whose calibration serves until a defender is configured, and for a fusion without one."""

FOLDER_VARIABLE = "CP_ENV_CALIBRATION"
_WARNED_VARIABLE = "CP_ENV_CALIBRATION_WARNED"
"""What was warned of already, by this process or by the one that started it: workers inherit it."""


class NotCalibrated(UserWarning):
    """A defender rests on what was measured with other weights."""


def calibration_folder() -> Path:
    """The folder of the user's calibration files; the environment variable `CP_ENV_CALIBRATION` moves it."""
    override = os.environ.get(FOLDER_VARIABLE)
    if override:
        return Path(override)
    import platformdirs

    return Path(platformdirs.user_data_dir("cp_env")) / "calibration"


def own_file(detector: str) -> Path:
    """Where the user's calibration of the detector with this digest is, or would be."""
    return calibration_folder() / f"{detector}.json"


def shipped_file(fusion: str) -> Path:
    """The file that ships for a fusion; that of `DEFAULT` for a fusion without one."""
    path = SHIPPED / f"{fusion}.json"
    return path if path.exists() else SHIPPED / f"{DEFAULT}.json"


def calibration_for(fusion: str, part: str, path: Path | None = None) -> Calibration:
    """The calibration that a defender takes one part from.

    Args:
        fusion: how the ego fuses. An `EgoFusion` also tells the digest of its detector; for a plain text, the shipped
            file of the fusion serves without a word.
        part: which part of it is needed; a file without that part is passed over.
        path: a file that was named; it is taken whatever it was measured with.

    Returns:
        A calibration that holds the part.

    Raises:
        ValueError: a file that is broken, or a named file without the part.
    """
    detector = fusion.detector if isinstance(fusion, EgoFusion) else None
    if path is not None:
        found = _read(path)
        if part not in found.parts:
            raise ValueError(f"{path} holds no {part}, only {', '.join(found.parts)}; measure it with cp-calibrate")
    else:
        found = _own(detector, part) or _read(shipped_file(fusion))
    if detector is not None and found.detector != detector:
        _warn(found, part, detector)
    return found


def _own(detector: str | None, part: str) -> Calibration | None:
    """The user's calibration of the detector, if there is one that holds the part."""
    if detector is None or not own_file(detector).is_file():
        return None
    found = _read(own_file(detector))
    return found if found.detector == detector and part in found.parts else None


def _read(path: Path) -> Calibration:
    """The calibration in a file, read once for as long as the file does not change."""
    try:
        status = path.stat()
    except OSError:
        return read_calibration(path)
    return _kept(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _kept(path: Path, changed: int, size: int) -> Calibration:
    del changed, size
    return read_calibration(path)


def _warn(found: Calibration, part: str, detector: str) -> None:
    """Warn that a part was measured with other weights; once for each in a process and those it starts."""
    key = f"{part}:{found.detector}:{detector}"
    warned = os.environ.get(_WARNED_VARIABLE, "").split()
    if key in warned:
        return
    os.environ[_WARNED_VARIABLE] = " ".join([*warned[-50:], key])
    warnings.warn(
        f"the calibration of this defender ({part}) was measured with other weights: {found.path.name} is of the "
        f"detector {found.detector}, the ego's is {detector}. Its thresholds or densities may be wrong here. Measure "
        "them: cp-calibrate --detector YOURS --scenes YOURS (docs/commands.md)",
        NotCalibrated,
        stacklevel=2,
    )
