"""How well a defence identifies attackers, and how much of the lost AP it restores."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike


def id_rate(suspects: Collection[int], attackers: Collection[int]) -> float:
    """ID rate (true positive rate): share of the attackers that are flagged; 1 if there is none."""
    return len(set(suspects) & set(attackers)) / len(set(attackers)) if attackers else 1.0


def mc_rate(suspects: Collection[int], attackers: Collection[int], n: int) -> float:
    """MC rate (false positive rate): share of the benign of vehicles 0 … n-1 that are flagged; 0 if none is benign."""
    benign = set(range(n)) - set(attackers)
    return len(set(suspects) & benign) / len(benign) if benign else 0.0


def recovery(ap: float, attacked: float, clean: float) -> float:
    """Share of the AP lost to an attack that a defence restores: (ap - attacked) / (clean - attacked).

    Below 0 where the defence does more harm than the attack, above 1 where it beats the clean value. If the attack cost
    nothing (clean <= attacked) there is nothing to restore: 1 if `ap` is at least the clean value, else 0.
    """
    loss = clean - attacked
    if loss <= 0:
        return 1.0 if ap >= clean else 0.0
    return (ap - attacked) / loss


@dataclass(frozen=True, eq=False)
class Roc:
    """The receiver operating characteristic: a point for each threshold, from the highest; both rates rise."""

    threshold: Float[np.ndarray, " S"]  # a vehicle is flagged if its score reaches it; the first flags nobody
    fpr: Float[np.ndarray, " S"]  # share of the benign that are flagged
    tpr: Float[np.ndarray, " S"]  # share of the malicious that are flagged

    @property
    def auc(self) -> float:
        """Area under the curve, straight between its points: the chance that a malicious vehicle outscores a benign one
        drawn with it, a tie counted half."""
        steps = np.diff(self.fpr) * (self.tpr[1:] + self.tpr[:-1]) / 2
        return float(steps.sum())

    def tpr_at(self, fpr: float = 0.03) -> float:
        """The largest TPR of a threshold whose FPR is at most that; nothing is interpolated."""
        return float(self.tpr[self.fpr <= fpr].max())


def roc(benign: ArrayLike, malicious: ArrayLike) -> Roc:
    """The ROC of scores, higher for more suspect, such as the `belief()` of a defender.

    Args:
        benign: scores of benign vehicles, one for each vehicle and frame; for a false-alarm rate that no attack
            disturbs, those of runs without an attack.
        malicious: scores of malicious vehicles.

    Returns:
        The curve, from (0, 0) to (1, 1).

    Raises:
        ValueError: one of the two is empty, or a score is NaN.
    """
    no, yes = (np.sort(np.asarray(scores, dtype=np.float64).ravel()) for scores in (benign, malicious))
    if not (no.size and yes.size):
        raise ValueError(f"a ROC needs scores of benign and of malicious vehicles; got {no.size} and {yes.size}")
    if np.isnan(no).any() or np.isnan(yes).any():
        raise ValueError("scores must not be NaN: leave out the frames without a belief")
    threshold = np.concatenate([[np.inf], np.unique(np.concatenate([no, yes]))[::-1]])
    flagged = [1 - np.searchsorted(scores, threshold, side="left") / scores.size for scores in (no, yes)]
    return Roc(threshold, *flagged)
