"""The toy crossings under a detector of full width, instead of the narrow one of the environments' tests."""

from __future__ import annotations

from tests.helpers.banks import bank, detector

__all__ = ["bank", "detector"]
