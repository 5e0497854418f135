"""The catalogue as a table, for the terminal and for the docs."""

from __future__ import annotations

from collections.abc import Sequence

from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.parameter import Parameter

COLUMNS = ("id", "parameter", "unit", "off", "bounds", "meaning")
"""What the terminal shows."""
MORE_COLUMNS = ("tolerance", "prior", "equation", "acts on", "shown by", "look-alikes")
"""What the docs show besides."""
ACTS_ON = {
    Stage.CONSTANT: "constants of the model",
    Stage.THRUST: "rotor thrust, every step",
    Stage.FORCE: "force, every step",
    Stage.FRICTION: "dry friction, every step",
}
PREAMBLE = """\
# Effects

Written by `vpptwin effects --markdown`; to change it, change the catalogue in `vpptwin/effects` and write it anew.

At `off` an effect does nothing. Where `off` is the upper bound, the effect is a limit that nothing reaches there. A
parameter that merely shapes an effect (`velocity`, `rest`, `place`, `width`, `height`) does nothing while the strength
before it is off; its `off` is a typical value, and its tolerance lets any value pass.

A twin YAML ([twin.md](twin.md)) takes values within `bounds`. `tolerance` is the deviation that a well-built rig may
show unremarked: below it a diagnosis accuses nothing. Training draws from the prior. Look-alikes are hard to tell
apart: that takes the right manoeuvre.
"""


def describe_parameter(effect: Effect, parameter: Parameter) -> dict[str, str]:
    """One row of the table: column → text."""
    return {
        "id": effect.id,
        "parameter": parameter.name,
        "unit": parameter.unit or "-",
        "off": f"{parameter.off:g}",
        "bounds": f"{parameter.low:g} to {parameter.high:g}",
        "meaning": effect.summary,
        "tolerance": f"{parameter.tolerance:g}",
        "prior": str(parameter.prior),
        "equation": f"`{effect.equation}`",
        "acts on": ", ".join(f"`{name}`" for name in effect.writes) or ACTS_ON[effect.stage],
        "shown by": ", ".join(effect.shows),
        "look-alikes": ", ".join(effect.look_alikes) or "-",
    }


def print_catalogue(catalogue: Sequence[Effect], markdown: bool = False) -> None:
    """Print the catalogue in aligned columns, or as a page of Markdown with everything known about each effect."""
    rows = [describe_parameter(effect, parameter) for effect in catalogue for parameter in effect.parameters]
    if markdown:
        header = (*COLUMNS, *MORE_COLUMNS)
        print(PREAMBLE)
        print("| " + " | ".join(header) + " |")
        print("|" + "---|" * len(header))
        for row in rows:
            print("| " + " | ".join(row[name].replace("|", "\\|") for name in header) + " |")
        return
    lines = [COLUMNS, *(tuple(row[name] for name in COLUMNS) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines)]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip())
