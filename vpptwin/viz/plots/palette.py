"""Colours that colour-blind readers tell apart (Okabe and Ito), one per meaning, shared by scene and plots."""

from __future__ import annotations

BLUE = "#0072B2"
SKY = "#56B4E9"
GREEN = "#009E73"
YELLOW = "#F0E442"
ORANGE = "#E69F00"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#7F858C"

LOG = "#26292E"
SURROUNDINGS = "#BFC4CC"
TWIN = BLUE
BRIGHT = "#5CB8FF"  # the twin on dark ground
POSITIVE_THRUST = GREEN
NEGATIVE_THRUST = VERMILION
TARGET = PURPLE
TRAIL = LOG
DISC = GREY
TOP_MARK = YELLOW
BLADE = LOG


def to_int(colour: str) -> int:
    """A "#RRGGBB" colour as the integer that three.js takes."""
    return int(colour.removeprefix("#"), 16)


def to_hex(rgb: tuple[float, float, float]) -> str:
    """Red, green, blue in 0..1 as "#RRGGBB"."""
    return "#" + "".join(f"{round(255 * min(max(c, 0.0), 1.0)):02X}" for c in rgb)


def to_rgb(colour: str) -> tuple[float, float, float]:
    """A "#RRGGBB" colour as red, green, blue in 0..1."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue
