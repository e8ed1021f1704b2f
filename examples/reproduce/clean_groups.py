"""Table 1 of the PRBI paper: how often a random group holds no attacker, and the paper's values.

    python examples/reproduce/clean_groups.py

Each frame splits n vehicles into two groups and verifies both. η is the share of verifications so far that were normal
under a perfect verifier. The paper takes 2^-k as its limit, and Eq. (4) derives the number k of attackers from it. The
paper does not say how the vehicles are split. Three ways are tried:

    independent   each vehicle joins either group with probability 1/2, and an empty group is not verified
    half          a random split at ⌊n/2⌋
    even          a random split at a size drawn evenly from 1 … n - 1

"limit" is computed over all groups. For independent draws it is exactly Eq. (3): a group is clean and not empty with
probability 2^-k - 2^-n, and not empty with 1 - 2^-n. "η" is played for as many frames as the paper's. Its interval
holds 95 % of the episodes. "frames" is the number of frames until η stays within `band` of its limit: the median and
the middle 90 %. Only independent draws fit all four η of the paper: half a fleet is never clean at k = 4, and an even
split is clean in exactly 1/2 of the verifications at k = 1.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table

from cp_env.rendering import style

SPLITS = ("independent", "half", "even")
PAPER = {
    1: (0.484, 0.500, 40, 0.491),
    2: (0.226, 0.250, 29, 0.258),
    3: (0.097, 0.125, 28, 0.103),
    4: (0.032, 0.063, 21, 0.045),
}


@dataclass(frozen=True)
class Args:
    n: int = 5
    """vehicles"""
    episodes: int = 4000
    frames: int = 400
    band: float = 0.05
    """η counts as settled once it stays so near to its limit"""
    seed: int = 0
    out: Path = Path("out/clean_groups")


def in_first_group(split: str, args: Args, rng: np.random.Generator) -> Bool[np.ndarray, "E T n"]:
    """Whether a vehicle is in the first group of a frame."""
    shape = args.episodes, args.frames, args.n
    if split == "independent":
        return rng.random(shape) < 0.5
    ranks = rng.random(shape).argsort(axis=2)
    cut = args.n // 2 if split == "half" else rng.integers(1, args.n, shape[:2])[..., None]
    return ranks < cut


def played(split: str, k: int, args: Args) -> Float[np.ndarray, "E T"]:
    """η after each frame; the first k vehicles are malicious."""
    first = in_first_group(split, args, np.random.default_rng([args.seed, SPLITS.index(split), k]))
    groups = np.stack([first, ~first])
    verified = groups.any(axis=3)
    clean = verified & ~groups[..., :k].any(axis=3)
    return np.cumsum(clean.sum(axis=0), axis=1) / np.cumsum(verified.sum(axis=0), axis=1)


def limit(split: str, n: int, k: int) -> float:
    """The limit of the share of verifications that are normal, over all groups with their probabilities."""
    clean = verified = 0.0
    for group in itertools.product((False, True), repeat=n):
        size = sum(group)
        if size:
            weight = chance_of_size(split, size, n) / math.comb(n, size)
            verified += weight
            clean += weight * (not any(group[:k]))
    return clean / verified


def chance_of_size(split: str, size: int, n: int) -> float:
    """That either group of a split, drawn at random of the two, is of this size."""
    if split == "independent":
        return math.comb(n, size) / 2**n
    if split == "half":
        return ((size == n // 2) + (size == n - n // 2)) / 2
    return (size < n) / (n - 1)


def settled(eta: Float[np.ndarray, "E T"], target: float, band: float) -> Float[np.ndarray, " E"]:
    """Frames until η stays within `band` of its limit, up to the last one played."""
    outside = np.abs(eta - target) > band
    return np.where(outside.any(axis=1), eta.shape[1] - outside[:, ::-1].argmax(axis=1), 0) + 1.0


@style.plot_style()
def main(args: Args) -> None:
    title = f"share of verifications at random groups that are normal, n = {args.n}, {args.episodes} episodes"
    table = Table("k", "Eq. (3)", "2^-k", "split", "limit", "η [95 % of episodes]", "frames", title=title)
    figure, axes = plt.subplots(1, len(SPLITS), figsize=(style.PAGE, 3.3), sharey=True, layout="constrained")
    frames = np.arange(1, args.frames + 1)
    colours = style.attacker_colours(args.n - 1)
    for k in range(1, args.n):
        ideal, approximate = (2 ** (args.n - k) - 1) / (2**args.n - 1), 2.0**-k
        horizon = PAPER[k][2] if args.n == 5 else 40
        for split, axis in zip(SPLITS, axes, strict=True):
            eta, target = played(split, k, args), limit(split, args.n, k)
            low, high = np.quantile(eta[:, horizon - 1], [0.025, 0.975])
            wait = np.quantile(settled(eta, target, args.band), [0.5, 0.05, 0.95])
            cells = f"{target:.3f}", f"{eta[:, horizon - 1].mean():.3f} [{low:.3f}, {high:.3f}]"
            head = (str(k), f"{ideal:.3f}", f"{approximate:.3f}") if split == "independent" else ("", "", "")
            table.add_row(*head, split, *cells, "{:.0f} [{:.0f}, {:.0f}]".format(*wait))
            low_band, high_band = np.quantile(eta, [0.05, 0.95], axis=0)
            axis.fill_between(frames, low_band, high_band, color=colours[k - 1], alpha=0.22, lw=0)
            axis.plot(frames, eta.mean(axis=0), color=colours[k - 1], label=f"k = {k}")
            axis.axhline(approximate, color=colours[k - 1], ls=":", lw=1)
            if args.n == 5:
                axis.plot(PAPER[k][2], PAPER[k][3], "x", color=colours[k - 1], ms=7, mew=2)
        if args.n == 5:
            table.add_row("", "", "", "paper", "", f"{PAPER[k][3]:.3f}", str(PAPER[k][2]), end_section=True)
    for split, axis in zip(SPLITS, axes, strict=True):
        axis.set(title=split, xlabel="frames", xlim=(1, min(100, args.frames)), ylim=(0, 0.7))
    axes[0].set_ylabel("η: share of normal verifications")
    axes[-1].plot([], [], "k:", lw=1, label="$2^{-k}$")
    axes[-1].plot([], [], "x", color=style.GREY, ms=7, mew=2, label="the paper's")
    figure.legend(*axes[-1].get_legend_handles_labels(), loc="outside lower center", ncols=args.n + 1)
    style.save_plot(figure, args.out / "clean_groups.png")
    plt.close(figure)
    Console(width=110).print(table, "drawn: " + str(args.out / "clean_groups.png"), sep="\n")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
