"""The catalogue as a table, for the terminal and for the docs."""

from __future__ import annotations

from collections.abc import Sequence

from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.parameter import Parameter

COLUMNS = ("id", "parameter", "unit", "off", "bounds", "meaning")
"""What the terminal shows."""
MORE_COLUMNS = ("tolerance", "prior", "source", "equation", "acts on", "shown by", "look-alikes")
FINGERPRINT = "fingerprint"
"""What the docs show besides."""
ACTS_ON = {
    Stage.CONSTANT: "constants of the model",
    Stage.THRUST: "rotor thrust, every step",
    Stage.FORCE: "force, every step",
    Stage.FRICTION: "dry friction, every step",
    Stage.SLIP: "how dry friction acts, every step",
}
PREAMBLE = """\
# Effects

Written by `vpptwin effects --markdown`; to change it, change the catalogue in `vpptwin/effects` and write it anew.

At `off` an effect does nothing. Where `off` is the upper bound, the effect is a limit that nothing reaches there. A
parameter that merely shapes an effect (`velocity`, `rest`, `place`, `width`, `height`, `frequency`, `zeta`) does
nothing while the strength before it is off; its `off` is a typical value, and its tolerance lets any value pass.

A twin YAML ([twin.md](twin.md)) takes values within `bounds`. `tolerance` is the deviation that a well-built rig may
show unremarked: below it a diagnosis accuses nothing. Training draws from the prior. `source` tells where these
numbers come from: nobody has measured this rig, so nearly all are [assumptions](assumed.md), those of `vehicle.yaml`
too. Look-alikes are hard to tell apart: that takes the right manoeuvre.

A fingerprint shows what an effect does to a flight with steps along x and z, flips and inverted hover: left how the
motion, or what a sensor says of it, departs from that of a twin without the effect within 50 ms under the same
commands; right the same departures over what they follow. `vpptwin effects --pictures docs/effects` draws them anew,
each effect five typical sizes away from off. Contacts have none: nothing touches in that flight.

What is missing here you can add without touching our code: [an effect of your own](own_effects.md).
"""


def describe_parameter(effect: Effect, parameter: Parameter) -> dict[str, str]:
    """One row of the table: column → text."""
    return {
        "id": effect.id, "parameter": parameter.name, "unit": parameter.unit or "-", "off": f"{parameter.off:g}",
        "bounds": f"{parameter.low:g} to {parameter.high:g}", "meaning": effect.summary,
        "tolerance": f"{parameter.tolerance:g}", "prior": str(parameter.prior), "source": parameter.source or "-",
        "equation": f"`{effect.equation}`",
        "acts on": ", ".join(f"`{name}`" for name in effect.writes) or ACTS_ON[effect.stage],
        "shown by": ", ".join(effect.shows), "look-alikes": ", ".join(effect.look_alikes) or "-",
    }  # fmt: skip


def print_catalogue(catalogue: Sequence[Effect], markdown: bool = False, pictures: str = "") -> None:
    """Print the catalogue in aligned columns, or as a page of Markdown with everything known about each effect.

    Args:
        catalogue: the effects.
        markdown: a page instead of columns.
        pictures: folder of the fingerprints as the page sees it, "" for none.
    """
    rows = [describe_parameter(effect, parameter) for effect in catalogue for parameter in effect.parameters]
    if markdown:
        header: tuple[str, ...] = (*COLUMNS, *MORE_COLUMNS)
        print(PREAMBLE)
        if pictures:
            header = (*header, FINGERPRINT)
            seen = {effect.id for effect in catalogue if effect.touching}
            for row in rows:
                name = row["id"]
                image = f'<img src="{pictures}/{name}.png" width="360" alt="what {name} does">'
                row[FINGERPRINT] = "" if name in seen else image
                seen.add(name)
        print("| " + " | ".join(header) + " |")
        print("|" + "---|" * len(header))
        for row in rows:
            print("| " + " | ".join(row[name].replace("|", "\\|") for name in header) + " |")
        return
    lines = [COLUMNS, *(tuple(row[name] for name in COLUMNS) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines)]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip())
