"""All families of inputs."""

from __future__ import annotations

from gymnasium.error import ResetNeeded

from tests.campaign.inputs import entrances, files, names
from tests.campaign.inputs.trial import Family

FAMILIES: dict[str, Family] = {
    "names": Family(names.names, (ValueError,), 0.40, 20_000),
    "objects": Family(names.objects, (ValueError,), 0.05, 2_500),
    "settings": Family(names.settings, (ValueError,), 0.30, 15_000),
    "options": Family(entrances.options, (ValueError,), 0.03, 1_500),
    "resets": Family(entrances.resets, (ValueError, TypeError), 0.04, 2_000),
    "actions": Family(entrances.actions, (ValueError, ResetNeeded), 0.05, 2_500),
    "files": Family(files.files, (ValueError, OSError), 0.10, 5_000),
    "records": Family(files.records, (), 0.03, 1_500),
}
"""Shares add up to one."""
