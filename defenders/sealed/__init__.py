"""A defender in a process of its own, which holds handles of views and never the views.

What a defender is allowed to know goes through a pipe as lines of JSON: frames, handles, queries and numbers. So it can
neither read what the ego sees, nor remember what an earlier run gave away, nor reach the world in any other way.
"""

from __future__ import annotations

from defenders.sealed.proxy import SealedDefender, SealedError, seal

__all__ = ["SealedDefender", "SealedError", "seal"]
