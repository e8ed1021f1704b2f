"""One style for all pictures: colours with fixed meanings, type sizes, widths, and how plots are stored.

The colours are those of `cp_env.palette.colours`. What is wrong in a picture differs in shape as well: a missed vehicle
is filled, a ghost is crossed out.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from cp_env.palette.colours import (
    BAND,
    BLACK,
    BLUE,
    DARK,
    GREEN,
    GREY,
    GRID,
    LIGHT,
    ORANGE,
    PURPLE,
    SILVER,
    SKY,
    VERMILLION,
    YELLOW,
    Colour,
    Meanings,
    rgb,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [  # the colours as well: a program of plots needs no other module
    "BAND", "BLACK", "BLUE", "DARK", "DEFENDERS", "DPI", "GREEN", "GREY", "GRID", "LIGHT", "ORANGE", "PAGE", "PURPLE",
    "SILVER", "SKY", "SPARE", "VERMILLION", "YELLOW", "Colour", "Meanings", "attacker_colours", "defender_colours",
    "parameters", "plot_style", "rgb", "save_image", "save_plot", "share_axis",
]  # fmt: skip

PAGE = 6.9
"""Width of a plot, inches: a page of the documentation is 690 pixels wide, and text of 9 points stays readable."""
DPI = 200
"""Pixels per inch of a stored plot: two for each pixel of the page."""


DEFENDERS: Mapping[str, str] = {
    "none": GREY,
    "ego_only": SILVER,
    "oracle": BLACK,
    "prbi": BLUE,
    "robust_prbi": SKY,
    "robosac": ORANGE,
    "pasac": GREEN,
    "bayes": VERMILLION,
}
"""The colour of each defender in every plot."""
SPARE = (SKY, PURPLE, "#8C6D1F", "#7B5EA7", "#4E9F3D", YELLOW, "#8A2A2A")
"""Colours of further defenders, and of the same ones with other options."""


def defender_colours(names: Sequence[str]) -> dict[str, tuple[float, float, float]]:
    """A colour for each defender, red, green and blue in [0, 1]: its own, a spare one, or a step of a wheel.

    Args:
        names: specs of defenders such as "prbi:threshold=calibrated"; the first of a family has the family's colour.
    """
    chosen: dict[str, str] = {}
    for name in names:
        own = DEFENDERS.get(name.partition(":")[0])
        if own is not None and own not in chosen.values():
            chosen[name] = own
    spare = [colour for colour in SPARE if colour not in chosen.values()]
    rest = [name for name in dict.fromkeys(names) if name not in chosen]
    unit = {name: _unit(colour) for name, colour in {**chosen, **dict(zip(rest, spare, strict=False))}.items()}
    for number, name in enumerate(rest[len(spare) :]):
        unit[name] = _wheel(number / (len(rest) - len(spare)))
    return {name: unit[name] for name in dict.fromkeys(names)}


def attacker_colours(n: int) -> list[str]:
    """A colour for each number of attackers, 1 to n: the more of them, the darker the orange. None at all is `BLUE`.

    Args:
        n: the largest number of attackers.
    """
    import matplotlib
    from matplotlib.colors import to_hex

    return [to_hex(matplotlib.colormaps["YlOrBr"](0.42 + 0.58 * i / max(n - 1, 1))) for i in range(n)]


def parameters() -> dict[Any, Any]:
    """Matplotlib's rcParams of all plots."""
    from cycler import cycler  # comes with matplotlib, which films do not need

    return {
        "font.family": "DejaVu Sans",
        "font.size": 9,
        "axes.titlesize": 9.5,
        "axes.labelsize": 9,
        "xtick.labelsize": 8.5,
        "ytick.labelsize": 8.5,
        "legend.fontsize": 8.5,
        "legend.frameon": False,
        "legend.handlelength": 1.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": GREY,
        "axes.axisbelow": True,
        "axes.grid": True,
        "grid.color": GRID,
        "axes.prop_cycle": cycler(color=[BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK]),
        "lines.linewidth": 1.6,
        "figure.dpi": 100,
        "savefig.dpi": DPI,
        "savefig.facecolor": "white",
    }


def share_axis(axis: Axes) -> None:
    """Make a plot's y axis one of shares, 0 to 1, by square roots: small ones can be read beside one of nearly 1."""
    axis.set_yscale("function", functions=(lambda share: np.sqrt(np.maximum(share, 0)), np.square))
    axis.set_ylim(0, 1)
    axis.set_yticks([0, 0.02, 0.1, 0.25, 0.5, 1], ["0", "0.02", "0.1", "0.25", "0.5", "1"])


@contextmanager
def plot_style() -> Iterator[None]:
    """The style of all plots, for a block, or for a function that it decorates."""
    import matplotlib

    with matplotlib.rc_context(parameters()):
        yield


def save_plot(figure: Figure, path: str | Path) -> Path:
    """Store a plot as a PNG at `DPI`; returns its path.

    Args:
        figure: what is stored.
        path: of the file; its folder is made if it is missing.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return save_image(Image.open(buffer).convert("RGB"), path)


def save_image(image: Image.Image, path: str | Path) -> Path:
    """Store an image as a PNG of 256 colours, a third as large as with all of them; returns its path.

    Args:
        image: of mode "RGB". Each of the 256 is the most frequent of those that it stands for, so that areas keep their
            colour, and only soft edges are approximate.
        path: of the file; its folder is made if it is missing.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    small = image.quantize(256, method=Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    pixels, rows = np.asarray(image).reshape(-1, 3), np.asarray(small).ravel()
    pairs, counts = np.unique(np.column_stack([rows, pixels]), axis=0, return_counts=True)
    palette = np.zeros((256, 3), np.uint8)
    for row, *colour in pairs[np.argsort(counts, kind="stable")].tolist():
        palette[row] = colour  # the most frequent comes last
    small.putpalette(palette.ravel().tolist())
    small.save(path, optimize=True)
    return path


def _unit(colour: str) -> tuple[float, float, float]:
    red, green, blue = rgb(colour)
    return red / 255, green / 255, blue / 255


def _wheel(turn: float) -> tuple[float, float, float]:
    """A colour at `turn` of a wheel of hues."""
    import colorsys

    return colorsys.hsv_to_rgb(turn, 0.75, 0.8)
