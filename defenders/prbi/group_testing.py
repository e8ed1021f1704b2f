"""What verdicts on groups prove about vehicles, for `Prbi(stopping="robust")`.

If a group passes, everyone in it is honest; if it fails, somebody in it lies. So a vehicle is *cleared* once it was in
a group that passed, and *convicted* once it is the only member of a failed group that is not cleared (the "definite
defectives" of group testing: Aldridge, Baldassini, Johnson, IEEE Trans. Inf. Theory 60, 2014). The others are *open*.
With right verdicts, and liars that lie whenever anyone is looked at, neither is ever wrong.
"""

from __future__ import annotations

from collections.abc import Mapping

from defenders.prbi.frame_views import Group, union


class Proof:
    """Grows with the verdicts of every frame, and starts again from the last frame alone when they contradict."""

    def __init__(self, n_vehicles: int) -> None:
        self.everyone: Group = frozenset(range(n_vehicles))
        self.forget()

    def forget(self) -> None:
        self.cleared: Group = frozenset()
        self.failed: set[Group] = set()

    def learn(self, verdicts: Mapping[Group, bool]) -> bool:
        """Take in one frame's verdicts (True: the group passed). Returns whether anybody was newly settled.

        Verdicts contradict each other when nobody is left in a failed group who could lie, or nobody at all who could
        be honest. Those of earlier frames are forgotten then, and this frame's too if they contradict each other.
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
