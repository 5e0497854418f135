"""The catalogue as a table, for the terminal and for the docs."""

from __future__ import annotations

from collections.abc import Sequence

from vpptwin.effects.base import Effect

HEADER = ("id", "parameter", "unit", "off", "bounds", "prior", "meaning", "equation", "look-alikes")


def tabulate(catalogue: Sequence[Effect]) -> list[tuple[str, ...]]:
    """One row a parameter: the columns of HEADER."""
    rows = []
    for effect in catalogue:
        for parameter in effect.parameters:
            rows.append(
                (
                    effect.id,
                    parameter.name,
                    parameter.unit or "-",
                    f"{parameter.off:g}",
                    f"{parameter.low:g} to {parameter.high:g}",
                    str(parameter.prior),
                    effect.summary,
                    effect.equation,
                    ", ".join(effect.look_alikes) or "-",
                )
            )
    return rows


def print_catalogue(catalogue: Sequence[Effect], markdown: bool = False) -> None:
    """Print the catalogue, as a Markdown table or in aligned columns without the prior and the look-alikes."""
    rows = tabulate(catalogue)
    if markdown:
        print("| " + " | ".join(HEADER) + " |")
        print("|" + "---|" * len(HEADER))
        for row in rows:
            print("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |")
        return
    shown = [(*row[:5], row[6]) for row in [HEADER, *rows]]
    widths = [max(len(row[i]) for row in shown) for i in range(len(shown[0]))]
    for row in shown:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
