"""Colours by hand, and meanings that keep their hue on both grounds. How well they are told apart: `test_style.py`."""

from __future__ import annotations

import colorsys
from dataclasses import fields

import pytest

from cp_env.palette.colours import BLUE, DARK, LIGHT, Meanings, rgb

HUES = ("truth", "found", "missed", "ghost", "attacker", "suspect")


def test_numbers_by_hand() -> None:
    assert rgb(BLUE) == (0, 114, 178) and rgb("#ff00Aa") == (255, 0, 170)


def hue(colour: str) -> float:
    """Degrees."""
    return 360 * colorsys.rgb_to_hsv(*(value / 255 for value in rgb(colour)))[0]


@pytest.mark.parametrize("meaning", HUES)
def test_a_meaning_keeps_its_hue(meaning: str) -> None:
    apart = abs(hue(getattr(LIGHT, meaning)) - hue(getattr(DARK, meaning)))
    assert min(apart, 360 - apart) < 20


@pytest.mark.parametrize("meanings", [LIGHT, DARK], ids=["light", "dark"])
def test_no_two_meanings_share_a_colour(meanings: Meanings) -> None:
    colours = [rgb(getattr(meanings, field.name)) for field in fields(meanings) if field.name not in ("ego", "faint")]
    assert len(set(colours)) == len(colours)
