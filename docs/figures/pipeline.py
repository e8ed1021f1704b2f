"""Draw the pipeline and the threat: docs/pipeline.svg.

A drawing without data: boxes and arrows at fixed places, in points of a page 7.2 inches wide. Colours are those of
Okabe and Ito, which the colour-blind tell apart; what is malicious is hatched and named besides.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import tyro
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Rectangle

from cp_env.rendering.style import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILLION

INK, PANEL = BLACK, "#F3F5F7"
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.6,
    "hatch.linewidth": 0.5,
    "mathtext.fontset": "dejavusans",
    "svg.fonttype": "path",  # the same letters everywhere
    "svg.hashsalt": "cp-env",  # the same bytes every time
}
WIDTH, HEIGHT = 518, 398  # points; 7.2 inches wide

LANES = (
    # name, whether it is malicious, height of its middle
    ("vehicle 0: ego", False, 336),
    ("vehicle 1", False, 299),
    ("vehicle 2", True, 262),
    ("vehicle n − 1", True, 219),
)
SENSE, ENCODE, SEND, ATTACK = 112, 179, 263, 421  # middles of the columns of the upper half
WARP, PERCEIVE, DEFENDER, VERDICT = 46, 155, 331, 461  # and of the lower half
MIDDLE, BOTTOM = 128, 38  # heights of the lower half's two rows
BOUND = r"over $\delta_i$ with $\Vert\delta_i\Vert \leq \Delta$"


@dataclass
class Args:
    """Draw the pipeline and the threat."""

    out: Path = Path("docs/pipeline.svg")
    """the drawing"""
    png: Path | None = None
    """the same as pixels, at twice the size of a page 690 pixels wide"""


def box(ax: Axes, x: float, y: float, width: float, height: float, text: str, colour: str = INK, **more: Any) -> None:
    """A rounded box around (x, y) with its text in the middle; `malicious=True` hatches it."""
    malicious = more.pop("malicious", False)
    corner = (x - width / 2, y - height / 2)
    shape: dict[str, Any] = {"boxstyle": "round,pad=0,rounding_size=5", "linewidth": 1.2, "zorder": 2}
    ax.add_patch(FancyBboxPatch(corner, width, height, facecolor="white", edgecolor=colour, **shape))
    if malicious:
        faint: dict[str, Any] = {
            "facecolor": "none",
            "edgecolor": f"{colour}40",
            "hatch": "////",
            **shape,
            "linewidth": 0,
        }
        ax.add_patch(FancyBboxPatch(corner, width, height, **faint))
    plate = {"facecolor": "white", "edgecolor": "none", "pad": 1.0} if malicious else None
    ax.text(x, y, text, ha="center", va="center", color=INK, zorder=4, linespacing=1.35, bbox=plate, **more)


def arrow(ax: Axes, *points: tuple[float, float], colour: str = INK, **more: Any) -> None:
    """A line through the points, with a head at the last."""
    line: dict[str, Any] = {"color": colour, "linewidth": 1.3, "zorder": 3, **more}
    xs, ys = zip(*points, strict=True)
    if len(points) > 2:
        ax.plot(xs[:-1], ys[:-1], solid_capstyle="butt", **line)
    head: dict[str, Any] = {
        "arrowstyle": "-|>,head_width=0.24,head_length=0.5",
        "shrinkA": 0,
        "shrinkB": 0,
        "mutation_scale": 10,
    }
    ax.annotate("", xy=points[-1], xytext=points[-2], arrowprops={**head, **line}, zorder=3)


def panel(ax: Axes, left: float, bottom: float, width: float, height: float, title: str) -> None:
    """A grey field with its title at the top left."""
    ax.add_patch(Rectangle((left, bottom), width, height, facecolor=PANEL, edgecolor="none", zorder=0))
    ax.text(left + 6, bottom + height - 6, title, ha="left", va="top", weight="bold", color=INK)


def vehicles(ax: Axes) -> None:
    """The upper half: every vehicle senses, encodes and sends; the attack adds δ to what the malicious send."""
    panel(ax, 2, 197, 206, 199, "Every vehicle: sense, encode")
    panel(ax, 214, 197, 98, 199, "Channel")
    panel(ax, 318, 197, 198, 199, "Attack")
    for x, heading in ((SENSE, "LiDAR"), (ENCODE, "encoder"), (SEND, "feature map")):
        ax.text(x, 362, heading, ha="center", color=GREY, size=8)
    for name, malicious, y in LANES:
        colour = VERMILLION if malicious else BLUE
        role = "malicious" if malicious else "benign"
        box(ax, 44, y, 76, 30, f"{name}\n{role}", colour, malicious=malicious, size=8)
        box(ax, SENSE, y, 40, 26, "$C_i$", colour)
        box(ax, ENCODE, y, 40, 26, r"$f_\mathcal{E}$", colour)
        box(ax, SEND, y, 62, 26, r"$F_i + \delta_i$" if malicious else "$F_i$", colour, malicious=malicious)
        arrow(ax, (82, y), (SENSE - 20, y))
        arrow(ax, (SENSE + 20, y), (ENCODE - 20, y))
        arrow(ax, (ENCODE + 20, y), (SEND - 31, y))
        if malicious:
            arrow(ax, (ATTACK - 81, y), (SEND + 31, y), colour=VERMILLION)
    for x in (44, SENSE, ENCODE, SEND):
        ax.text(x, (LANES[2][2] + LANES[3][2]) / 2, "⋮", ha="center", va="center", color=GREY)
    text = "adversary\nscripted attack or learned policy,\nmaximises the detection loss, Eq. (2),\n" + BOUND
    box(ax, ATTACK, 240, 162, 74, text, VERMILLION, size=7.8)
    note = (
        "One adversary drives all malicious vehicles.\nThe ego may be one of them.\n"
        "Perturbations enter here and only here,\nbefore the warp, Eq. (1)."
    )
    ax.text(324, 369, note, ha="left", va="top", color=INK, size=7.8, linespacing=1.45)


def ego(ax: Axes) -> None:
    """The lower half: the ego warps and fuses; the defender asks for groups and gives a verdict."""
    panel(ax, 2, 2, 514, 181, "")
    ax.text(PERCEIVE - 47, 177, "Ego: fuse under a defence", ha="left", va="top", weight="bold", color=INK)
    arrow(ax, (SEND, 197), (SEND, 190), (WARP, 190), (WARP, MIDDLE + 22))
    box(ax, WARP, MIDDLE, 74, 44, "warp into the\nego frame\n" + r"$f_\mathcal{T}$", size=7.8)
    box(
        ax,
        PERCEIVE,
        MIDDLE,
        94,
        56,
        "fuse and decode\na group of vehicles\n" + r"$f_\mathcal{D} \circ f_\mathcal{F}$",
        size=7.8,
    )
    box(ax, DEFENDER, MIDDLE, 106, 56, "defender\n" + r"compares views by" + "\nsimilarity, Eq. (5)", GREEN, size=7.8)
    box(ax, VERDICT, MIDDLE, 94, 56, "verdict\nwho collaborates,\nwho is suspected", GREEN, size=7.8)
    arrow(ax, (WARP + 37, MIDDLE), (PERCEIVE - 47, MIDDLE))
    arrow(ax, (DEFENDER - 53, MIDDLE + 13), (PERCEIVE + 47, MIDDLE + 13), colour=GREEN)
    arrow(ax, (PERCEIVE + 47, MIDDLE - 13), (DEFENDER - 53, MIDDLE - 13))
    between = (PERCEIVE + 47 + DEFENDER - 53) / 2
    ax.text(between, MIDDLE + 17, "asks for groups", ha="center", va="bottom", size=7.6, color=INK)
    ax.text(between, MIDDLE - 17, "one view a group", ha="center", va="top", size=7.6, color=INK)
    ax.text(between, MIDDLE, "verification rounds", ha="center", va="center", size=7.6, color=GREY, style="italic")
    arrow(ax, (DEFENDER + 53, MIDDLE), (VERDICT - 47, MIDDLE), colour=GREEN)

    box(ax, VERDICT, BOTTOM, 94, 44, "output\n" + r"$D$: the view of the" + "\ncollaborators", size=7.8)
    arrow(ax, (VERDICT, MIDDLE - 28), (VERDICT, BOTTOM + 22), colour=GREEN)
    arrow(ax, (VERDICT - 47, BOTTOM + 12), (DEFENDER, BOTTOM + 12), (DEFENDER, MIDDLE - 28), linestyle=(0, (3, 2)))
    ax.text(DEFENDER - 6, 76, "reference of the next frame", ha="right", va="center", size=7.6, color=INK)
    measures = (
        "measured by the referee:  damage = 1 − Jaccard(output, clean view),  AP@0.5, AP@0.7,\n"
        "verifications per frame,  ID rate,  MC rate,  frames to convergence"
    )
    box(ax, 189, 28, 362, 36, measures, PURPLE, size=7.6)
    arrow(ax, (VERDICT - 47, 28), (370, 28))


def draw() -> plt.Figure:
    """The whole drawing."""
    figure = plt.figure(figsize=(WIDTH / 72, HEIGHT / 72), facecolor="white")
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set_xlim(0, WIDTH)
    ax.set_ylim(0, HEIGHT)
    ax.axis("off")
    vehicles(ax)
    ego(ax)
    return figure


def main(args: Args) -> None:
    """Draw it and write the files."""
    with plt.rc_context(STYLE):
        figure = draw()
        figure.savefig(args.out, metadata={"Date": None})
        if args.png is not None:
            figure.savefig(args.png, dpi=2 * 690 * 72 / WIDTH)


if __name__ == "__main__":
    main(tyro.cli(Args))
