"""Where the library keeps files of its own."""

from __future__ import annotations

import os
from pathlib import Path


def cache_directory() -> Path:
    """Where encoded scenes are kept."""
    override = os.environ.get("CP_ENV_CACHE")
    if override:
        return Path(override)
    import platformdirs

    return Path(platformdirs.user_cache_dir("cp_env"))
