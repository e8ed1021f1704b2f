"""The lowest versions that `pyproject.toml` declares, as exact requirements: `python tests/project/lowest.py`.

It needs nothing but the standard library. `make lowest` installs what it prints. Left out are torch, which is installed
first, by the version at hand, and the extras whose packages are large or have environments of their own.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
APART = ("torch",)
EXTRAS_APART = ("sumo", "ray", "attacks-check")


def lowest(project: dict[str, object]) -> list[str]:
    """Exact requirements, sorted. ValueError for one that is no lower bound alone, or for two bounds of one name."""
    extras = project.get("optional-dependencies", {})
    assert isinstance(extras, dict)
    listed = [project.get("dependencies", []), *(of for name, of in extras.items() if name not in EXTRAS_APART)]
    found: dict[str, str] = {}
    for requirement in (one for group in listed for one in group):
        name, bound, version = requirement.partition(">=")
        if not bound or not version or any(sign in version for sign in "<>=!~,;"):
            raise ValueError(f"a dependency has a lower bound and no other, as in 'numpy>=1.26', not {requirement!r}")
        if found.setdefault(name, version) != version:
            raise ValueError(f"{name} has the lower bounds {found[name]} and {version}; write the same")
    return sorted(f"{name}=={version}" for name, version in found.items() if name not in APART)


if __name__ == "__main__":
    sys.stdout.write("\n".join(lowest(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"])) + "\n")
