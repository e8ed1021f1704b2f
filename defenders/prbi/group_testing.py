"""Group testing: what verdicts on groups say about vehicles, for `RobustPrbi`.

If a group passes, every member is benign. If it fails, at least one member is malicious. So a vehicle is *cleared* once
it was in a group that passed. It is *convicted* once it is the only member of a failed group that is not cleared (the
"definite defectives" of group testing: Aldridge, Baldassini, Johnson, IEEE Trans. Inf. Theory 60, 2014). The others
are *open*. If all verdicts are right and the attackers attack in every verified frame, neither set is ever wrong.
"""

from __future__ import annotations

from collections.abc import Mapping

from defenders.prbi.frame_views import Group, union


class GroupTest:
    """Cleared, convicted and open vehicles. If verdicts contradict each other, only the last frame's are kept."""

    def __init__(self, n_vehicles: int) -> None:
        self.everyone: Group = frozenset(range(n_vehicles))
        self.forget()

    def forget(self) -> None:
        self.cleared: Group = frozenset()
        self.failed: set[Group] = set()

    def learn(self, verdicts: Mapping[Group, bool]) -> bool:
        """Add the verdicts of one frame.

        Verdicts contradict each other if every member of a failed group is cleared, or if all vehicles are convicted.
        Then those of earlier frames are forgotten, and this frame's too if they contradict each other.

        Args:
            verdicts: Whether each group passed.

        Returns:
            Whether a vehicle was newly cleared or convicted.
        """
        before = len(self.open)
        self._add(verdicts)
        for again in (verdicts, {}):
            if self.contradictory:
                self.forget()
                self._add(again)
        return len(self.open) < before

    @property
    def contradictory(self) -> bool:
        return self.convicted == self.everyone or any(group <= self.cleared for group in self.failed)

    @property
    def convicted(self) -> Group:
        left = (group - self.cleared for group in self.failed)
        return union(rest for rest in left if len(rest) == 1)

    @property
    def open(self) -> Group:
        """Neither cleared nor convicted."""
        return self.everyone - self.cleared - self.convicted

    def _add(self, verdicts: Mapping[Group, bool]) -> None:
        self.cleared |= union(group for group, passed in verdicts.items() if passed)
        self.failed |= {group for group, passed in verdicts.items() if not passed}
