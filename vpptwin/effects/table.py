"""The catalogue as a table, for the terminal and for the docs."""

from __future__ import annotations

from collections.abc import Sequence

from vpptwin.effects.base import Effect
from vpptwin.effects.parameter import Parameter

COLUMNS = ("id", "parameter", "unit", "off", "bounds", "meaning")
"""What the terminal shows."""
MORE_COLUMNS = ("tolerance", "prior", "equation", "look-alikes")
FINGERPRINT = "fingerprint"
"""What the docs show besides."""
PREAMBLE = """\
# The catalogue of effects

Written by `vpptwin effects --markdown` from `vpptwin/effects`. These are the effects of the drone;
`vpptwin effects --twin FILE` lists those of any rig. Add [your own](own_effects.md).

- **off**: the value at which the effect does nothing. Where it is the upper bound, the effect is a limit. A parameter
  that only shapes an effect (`velocity`, `rest`, `place`, `width`, `height`, `frequency`, `zeta`) does nothing while
  the strength before it is off.
- **bounds**: what a [twin file](twin.md) accepts.
- **tolerance**: the deviation that a well-built rig may have; below it a diagnosis names nothing.
- **prior**: from which training draws.
- Nobody has measured this rig, so most numbers are [assumptions](assumed.md); `vpptwin/effects` and
  `vpptwin/robots/planar_drone/effects` name the source of each.
- **look-alikes**: effects that are hard to separate from it.
- **fingerprint**: what five typical sizes do to a flight with steps, flips and inverted hover. Left: the departure of
  motion or sensor from the nominal twin within 50 ms. Right: the same over the quantity that it follows.
  `vpptwin effects --pictures docs/effects` draws them.
"""


def describe_parameter(effect: Effect, parameter: Parameter) -> dict[str, str]:
    """One row of the table: column → text."""
    return {
        "id": effect.id, "parameter": parameter.name, "unit": parameter.unit or "-", "off": f"{parameter.off:g}",
        "bounds": f"{parameter.low:g} to {parameter.high:g}", "meaning": effect.summary,
        "tolerance": f"{parameter.tolerance:g}", "prior": str(parameter.prior), "equation": f"`{effect.equation}`",
        "look-alikes": ", ".join(effect.look_alikes) or "-",
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
                image = f'<img src="{pictures}/{name}.png" width="360" alt="{name}">'
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
