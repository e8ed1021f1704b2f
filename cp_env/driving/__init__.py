"""Driving on what is perceived: the ego as a car-following driver among recorded vehicles."""

from __future__ import annotations

from cp_env.driving.closed_loop import Drive, PseudoClosedLoop
from cp_env.driving.idm import CITY, DriverModel

__all__ = ["CITY", "Drive", "DriverModel", "PseudoClosedLoop"]
