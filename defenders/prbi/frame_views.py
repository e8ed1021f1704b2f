"""The views that a defender has queried in one frame, and their similarity to its reference."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable

from defenders.protocol import Frame, Query, View

Group = frozenset[int]
Queries = Generator[Query, list[View], None]


def union(groups: Iterable[Group]) -> Group:
    """Union of the groups."""
    return frozenset[int]().union(*groups)


class FrameViews:
    """Views of one frame by group. It begins with the full view, which is free; queried views are added.

    A group is consistent if the similarity of its view to the reference is at least ε of the group, Eq. (5).
    """

    def __init__(self, frame: Frame, reference: View, epsilon: Callable[[Group], float]) -> None:
        self.frame, self.reference, self.epsilon = frame, reference, epsilon
        self.views: dict[Group, View] = {frame.present: frame.seen}
        self._similarity: dict[Group, float] = {}

    def verify(self, groups: Iterable[Group]) -> Queries:
        """Query the groups that were not seen yet. Each is one verification."""
        yield from self._ask([group for group in groups if group not in self.views], True)

    def perceive(self, group: Group) -> Queries:
        """Query the group that is fused for the output: no verification, since the ego perceives it anyway."""
        yield from self._ask([group] if group not in self.views else [], False)

    def reject(self, group: Group) -> Queries:
        """Pay for a view that was perceived for the output and is not used after all: it has been a verification."""
        yield Query([group])

    def similarity(self, group: Group) -> float:
        """Similarity of the group's view to the reference."""
        if group not in self._similarity:
            self._similarity[group] = self.frame.similarity(self.views[group], self.reference)
        return self._similarity[group]

    def is_consistent(self, group: Group) -> bool:
        """Whether the group's view is consistent with the reference, Eq. (5)."""
        return self.similarity(group) >= self.epsilon(group)

    def verdicts(self) -> dict[Group, bool]:
        """Whether each group seen is consistent."""
        return {group: self.is_consistent(group) for group in self.views}

    def support(self, group: Group) -> float:
        """Summed similarity of the group's view to the views of disjoint groups."""
        apart = [view for other, view in self.views.items() if group.isdisjoint(other)]
        return sum(self.frame.similarity(self.views[group], view) for view in apart)

    def _ask(self, groups: list[Group], verification: bool) -> Queries:
        if groups:
            self.views.update(zip(groups, (yield Query(groups, verification)), strict=True))
