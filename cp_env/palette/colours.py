"""The colours of all pictures, with fixed meanings.

They are those of Okabe and Ito, which people with any of the common colour deficiencies tell apart. Films stand on a
dark ground (`DARK`), plots on a white one (`LIGHT`). A meaning keeps its hue on both.

Source: M. Okabe, K. Ito, Color Universal Design (2008).
"""

from __future__ import annotations

from dataclasses import dataclass

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

BLACK, GREY, SILVER = "#1A1A1A", "#6B6B6B", "#A9AFB7"
BLUE, SKY, GREEN = "#0072B2", "#56B4E9", "#009E73"
YELLOW, ORANGE, VERMILLION, PURPLE = "#F0E442", "#E69F00", "#D55E00", "#CC79A7"
GRID, BAND = "#E3E6EA", "#FBF6C2"


@dataclass(frozen=True)
class Meanings:
    """The colour of everything that a picture of a frame shows."""

    ground: str
    ink: str  # text, and discs of vehicles that are fused
    faint: str  # lesser text, and rings of vehicles that are not fused
    grid: str
    street: str  # LiDAR points of the ground
    others: str  # points of the other vehicles' LiDAR
    ego: str  # points of the ego's LiDAR
    truth: str  # true vehicles that were found
    found: str  # boxes that the ego perceives where a vehicle is
    missed: str
    ghost: str
    attacker: str
    suspect: str


LIGHT = Meanings(
    ground="#FFFFFF",
    ink=BLACK,
    faint=GREY,
    grid=GRID,
    street="#DDDDDD",
    others="#B5BAC2",
    ego=GREY,
    truth=GREEN,
    found=BLUE,
    missed=YELLOW,
    ghost=PURPLE,
    attacker=VERMILLION,
    suspect=ORANGE,
)
DARK = Meanings(
    ground="#0D1016",
    ink="#F2F4F8",
    faint="#B4BCC8",
    grid="#232A35",
    street="#39414E",
    others="#808B9B",
    ego="#DCE2EA",
    truth="#2FC79B",
    found="#4FB0F5",
    missed="#F0E442",
    ghost="#E78AC0",
    attacker="#F26A1B",
    suspect="#F5B52E",
)


def rgb(colour: str) -> Colour:
    """Red, green and blue of "#RRGGBB"."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
