"""The views a defender has of one frame, and which of them resemble its reference."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable

from defenders.protocol import Frame, Query, View

Group = frozenset[int]
Asking = Generator[Query, list[View], None]


def union(groups: Iterable[Group]) -> Group:
    """Everyone who is in any of the groups."""
    return frozenset[int]().union(*groups)


class Looks:
    """Starts with the view of all present, which is free; what is asked for is added. Lives for one frame.

    A group passes if the similarity of its view to the reference is at least ε of the group, Eq. (5).
    """

    def __init__(self, frame: Frame, reference: View, epsilon: Callable[[Group], float]) -> None:
        self.frame, self.reference, self.epsilon = frame, reference, epsilon
        self.views: dict[Group, View] = {frame.present: frame.seen}
        self._likeness: dict[Group, float] = {}

    def verify(self, groups: Iterable[Group]) -> Asking:
        """Ask for the groups that were not seen yet; each is one verification."""
        yield from self._ask([group for group in groups if group not in self.views], True)

    def perceive(self, group: Group) -> Asking:
        """Ask for the group that is fused for the output: no verification, since the ego perceives it anyway."""
        yield from self._ask([group] if group not in self.views else [], False)

    def reject(self, group: Group) -> Asking:
        """A view that was perceived for the output and is not used after all has been a verification: pay for it."""
        yield Query([group])

    def likeness(self, group: Group) -> float:
        """Similarity of the group's view to the reference."""
        if group not in self._likeness:
            self._likeness[group] = self.frame.similarity(self.views[group], self.reference)
        return self._likeness[group]

    def passes(self, group: Group) -> bool:
        return self.likeness(group) >= self.epsilon(group)

    def verdicts(self) -> dict[Group, bool]:
        """Every group seen, and whether it passes."""
        return {group: self.passes(group) for group in self.views}

    def support(self, group: Group) -> float:
        """Summed similarity of the group's view to those of the groups that share no vehicle with it."""
        apart = [view for other, view in self.views.items() if group.isdisjoint(other)]
        return sum(self.frame.similarity(self.views[group], view) for view in apart)

    def _ask(self, groups: list[Group], verification: bool) -> Asking:
        if groups:
            self.views.update(zip(groups, (yield Query(groups, verification)), strict=True))
