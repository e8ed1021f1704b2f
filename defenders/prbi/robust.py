"""PRBI with a corrected rule for stopping: it converges on group testing instead of Eq. (14)."""

from __future__ import annotations

from collections.abc import Generator, Mapping

from defenders.prbi.defender import Prbi
from defenders.prbi.frame_views import FrameViews, Group
from defenders.prbi.group_testing import GroupTest
from defenders.prbi.inference import round_attackers
from defenders.prbi.interpretation import Reading
from defenders.protocol import Query, View

PUBLISHED_ONLY = ("second", "mean", "first", "flagged")
"""Options of a `Reading` that concern the published grouping and stopping, which `RobustPrbi` replaces."""


class RobustPrbi(Prbi):
    """Keeps the counts, m and P_benign of Algorithm 1, and stops on `group_testing.GroupTest`. Our correction.

    * The defender has converged when every vehicle is cleared or convicted. The convicted are flagged and the cleared
      are fused.
    * Soft sampling, Eq. (6), divides the vehicles that are not convicted. Group_2 always holds an open vehicle, and
      Group_1 at most all but one of them. After a frame that settled nobody, each group is the cleared vehicles and one
      open vehicle. So n frames are enough, however slowly m moves.
    * The search for an uncontaminated subset is made whenever nobody is cleared, not in the first abnormal frame only.
    * The cleared are fused only if their view is consistent; else the largest consistent group of this frame is.
    * If no group at all resembles the reference twice in a row, the reference is wrong: the first frame was attacked.
      The view that most resembles those of disjoint groups takes its place, and the counting starts over.
    """

    def __init__(
        self,
        *,
        epsilon: float = 0.35,
        window: int = 10,
        alpha: float = 0.01,
        gamma: float = 0.35,
        lam: float = 0.65,
        threshold: str | Mapping[int, float] = "paper",
        rounding: str = "floor",
        rearm: bool = False,
        reading: Reading | None = None,
    ) -> None:
        """Build the defender. The options are those of `Prbi`, less `stopping`.

        Raises:
            ValueError: If an option is out of range, or the reading is of a step that is replaced here.
        """
        reading = reading or Reading()
        for name in PUBLISHED_ONLY:
            if getattr(reading, name) != getattr(Reading(), name):
                raise ValueError(
                    f"robust_prbi groups and stops by group testing, so Reading({name}={getattr(reading, name)!r}) has "
                    f"no effect in it; leave {name} out, or use 'prbi'"
                )
        super().__init__(
            epsilon=epsilon,
            window=window,
            alpha=alpha,
            gamma=gamma,
            lam=lam,
            threshold=threshold,
            rounding=rounding,
            rearm=rearm,
            reading=reading,
        )

    def _begin(self, attackers: Group) -> None:
        super()._begin(attackers)
        self.group_test = GroupTest(len(self.everyone))
        self.stalled = False  # whether the last abnormal frame settled no vehicle

    def _soft_sampling(self) -> list[Group]:
        order = [i for i in self.order.tolist() if i in self.present]
        unsure, cleared = ([i for i in order if i in some] for some in (self.group_test.open, self.group_test.cleared))
        if self.stalled and cleared:
            return [frozenset((*cleared, i)) for i in unsure[-2:]]
        order = unsure + cleared
        cut = round_attackers(self.m, self.rounding) - len(self.group_test.convicted)
        cut = max(min(cut, len(unsure) - 1), 0)
        return [frozenset(part) for part in (order[:cut], order[cut:]) if part]

    def _learn(self, frame_views: FrameViews, *, validated: bool) -> None:
        learned = self.group_test.learn(frame_views.verdicts())
        if validated:
            self.stalled = not learned

    def _flagged(self) -> Group:
        """The convicted, and those convicted before, unless that is everyone."""
        convicted = self.group_test.convicted
        return self.known | convicted if self.known | convicted < self.everyone else convicted

    def _is_settled(self) -> bool:
        """Whether every vehicle is cleared or convicted."""
        return not self.group_test.open

    def _trusted(self, frame_views: FrameViews) -> Generator[Query, list[View], Group]:
        """The cleared if their view is consistent, else the largest consistent group; empty if there is none."""
        self.searched = False  # the search is made whenever nobody is cleared
        cleared = self.group_test.cleared & self.present
        if cleared:
            yield from frame_views.perceive(cleared)
            if frame_views.is_consistent(cleared):
                return cleared
            yield from frame_views.reject(cleared)
            self.group_test.learn(frame_views.verdicts())
        return max((group for group, passed in frame_views.verdicts().items() if passed), key=len, default=frozenset())

    def _most_similar(self, frame_views: FrameViews) -> Group:
        """The most similar view; the second time in a row the reference is replaced instead."""
        if self.lost < 2:
            return super()._most_similar(frame_views)
        group = max(self._others(frame_views), key=lambda group: (frame_views.support(group), -len(group)))
        self.reference = frame_views.views[group]
        self._begin(attackers=frozenset())
        return group
