"""One style: colours that the colour-blind tell apart and that stand out from the ground, defenders with fixed colours.

Deficiencies are simulated by the matrices of Machado, Oliveira and Fernandes (2009), severity 1, in linear RGB;
differences are Euclidean in CIELAB, where 2 is the least that is noticed and 10 is seen at a glance.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from jaxtyping import Float
from matplotlib.figure import Figure
from PIL import Image

from cp_env.rendering import style
from cp_env.rendering.style import (
    DARK,
    LIGHT,
    attacker_colours,
    defender_colours,
    plot_style,
    rgb,
    save_plot,
    share_axis,
)

DEUTERANOPIA = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
PROTANOPIA = [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
VISION = {"usual": np.eye(3), "deuteranopia": np.array(DEUTERANOPIA), "protanopia": np.array(PROTANOPIA)}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(colour: str) -> Float[np.ndarray, "3"]:
    """sRGB without its gamma."""
    value = np.array(rgb(colour)) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(colour: str, vision: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """CIELAB (D65) of the colour under that vision."""
    x, y, z = XYZ @ (vision @ linear(colour)).clip(0, 1) / XYZ.sum(axis=1)
    fx, fy, fz = (v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116 for v in (x, y, z))
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


def contrast(a: str, b: str) -> float:
    """Ratio of luminances, 1 to 21 (WCAG)."""
    low, high = sorted(float(XYZ[1] @ linear(colour)) for colour in (a, b))
    return (high + 0.05) / (low + 0.05)


def test_lab_by_hand() -> None:
    assert lab("#FFFFFF", VISION["usual"]) == pytest.approx([100, 0, 0], abs=0.1)
    assert lab("#FF0000", VISION["usual"]) == pytest.approx([53.2, 80.1, 67.2], abs=0.1)
    assert contrast("#000000", "#FFFFFF") == pytest.approx(21, abs=0.01)


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("ground", [DARK, LIGHT])
def test_what_was_found_missed_or_imagined_differs_for_every_vision(vision: str, ground: style.Meanings) -> None:
    seen = {kind: lab(getattr(ground, kind), VISION[vision]) for kind in ("found", "missed", "ghost", "attacker")}
    for a, b in itertools.combinations(seen, 2):
        assert np.linalg.norm(seen[a] - seen[b]) > 20, (a, b)


def test_text_and_marks_stand_out_from_the_ground_of_films() -> None:
    marks = asdict(DARK)
    for name in ("ink", "faint", "truth", "found", "missed", "ghost", "attacker", "suspect"):
        assert contrast(marks[name], DARK.ground) > 4.5, name
    assert contrast(style.GREY, LIGHT.ground) > 4.5 and contrast(style.BLACK, LIGHT.ground) > 4.5


@pytest.mark.parametrize("vision", VISION)
def test_defenders_differ_for_every_vision(vision: str) -> None:
    seen = [lab(colour, VISION[vision]) for colour in style.DEFENDERS.values()]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 10


def test_a_defender_has_one_colour_in_all_plots_and_variants_have_their_own() -> None:
    few, many = defender_colours(["prbi"]), defender_colours(["none", "mine", "prbi", "prbi:w=4", "bayes"])
    assert few["prbi"] == many["prbi"] == tuple(v / 255 for v in rgb(style.BLUE))
    assert len(set(many.values())) == 5
    crowd = [f"mine:Class{i}" for i in range(40)]
    assert list(defender_colours(crowd)) == crowd and len(set(defender_colours(crowd).values())) == 40
    assert defender_colours(["prbi", "prbi"]) == few


@pytest.mark.parametrize("vision", VISION)
def test_more_attackers_are_darker(vision: str) -> None:
    lightness = [lab(colour, VISION[vision])[0] for colour in attacker_colours(4)]
    assert (np.diff(lightness) < -8).all() and len(attacker_colours(1)) == 1


def test_small_shares_can_be_read_next_to_large_ones() -> None:
    """On an axis of square roots, 4 % stands at a fifth of its height."""
    axis = Figure().subplots()
    share_axis(axis)
    (_, low), (_, part), (_, high) = axis.transData.transform([(0, 0), (0, 0.04), (0, 1)])
    assert (part - low) / (high - low) == pytest.approx(0.2)


def test_plots_share_their_style_and_leave_the_caller_s_alone(tmp_path: Path) -> None:
    before = matplotlib.rcParams["font.size"], matplotlib.rcParams["axes.spines.top"]

    @plot_style()
    def draw() -> Path:
        assert matplotlib.rcParams["axes.spines.top"] is False
        figure = Figure(figsize=(style.PAGE, 2))
        figure.subplots().plot([0, 1], [1, 0], color=style.BLUE)
        return save_plot(figure, tmp_path / "deep" / "plot.png")

    path = draw()
    assert (matplotlib.rcParams["font.size"], matplotlib.rcParams["axes.spines.top"]) == before
    with Image.open(path) as image:
        assert image.size == (1380, 400) and image.mode == "P"
        assert rgb(style.BLUE) in {tuple(c) for c in np.asarray(image.convert("RGB")).reshape(-1, 3).tolist()}
