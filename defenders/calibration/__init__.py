"""What defenders rest on and is measured: thresholds and densities of similarities, one file for each detector.

A file is known by the digest of the detector's weights. `cp-calibrate` writes it, defenders find it by themselves.
"""

from __future__ import annotations

from defenders.calibration.files import Calibration, read_calibration, write_part
from defenders.calibration.lookup import NotCalibrated, calibration_folder, calibration_for, own_file

__all__ = [
    "Calibration",
    "NotCalibrated",
    "calibration_folder",
    "calibration_for",
    "own_file",
    "read_calibration",
    "write_part",
]
