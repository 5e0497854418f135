"""A verdict on one screen of a terminal, in the sentences of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vpptwin.diagnosis.judgement.verdict import Verdict
from vpptwin.report.error_table import ErrorTable
from vpptwin.report.summary import Summary
from vpptwin.report.words import format_digits
from vpptwin.system.terminal import open_console

MOST_WARNINGS = 3
"""Warnings that fit on a screen beside the rest."""
MOST_KINDS = 2
"""Kinds of rivals of a cause that do."""


def print_summary(verdict: Verdict, summary: Summary, out: Path, files: Sequence[str]) -> None:
    """Print what a verdict says and where its files lie."""
    console = open_console()
    console.print()
    for sentence in (summary.headline, *summary.more):
        console.print(sentence, style="bold")
    if summary.partial:
        console.print(summary.partial)
    if summary.rows:
        console.print()
        console.print(list_causes(summary))
    console.print()
    if left := [sentence for sentence in (summary.remains, summary.remedy) if sentence]:
        console.print("\n".join(left))
        console.print()
    console.print(list_findings(verdict, summary))
    if verdict.experiment is not None:  # not in the grid, whose breaks would not survive copying
        console.print(f"  {verdict.experiment.command}", soft_wrap=True)
    console.print()
    title = f"error on {verdict.held_out_windows} held-out windows{', before → after' if verdict.named else ''}"
    changed = [table for table in summary.tables if table.changed] or list(summary.tables)
    print_errors(console, title, changed)
    if same := [table.quantity for table in summary.tables if table not in changed]:
        console.print(f"unchanged: {', '.join(same)}", style="dim")
    before, after = format_digits(verdict.before.chi2), format_digits(verdict.after.chi2)
    console.print(f"held-out chi² {before} → {after} (1 = noise floor)")
    console.print()
    for name in files:
        console.print(str(out / name), soft_wrap=True)


def list_causes(summary: Summary) -> Table:
    """Causes and their rivals beside the effects' ids, a line for each kind."""
    grid = Table.grid(padding=(0, 2))
    for row in summary.rows:
        instead = row.instead[:MOST_KINDS]
        if more := len(row.instead) - len(instead):
            instead.append(f"{more} more in the report")
        grid.add_row(Text(row.effects, style="dim"), Text("\n".join([row.text, *instead])))
    return grid


def list_findings(verdict: Verdict, summary: Summary) -> Table:
    """Findings beside their headings."""
    grid = Table.grid(padding=(0, 2))
    warnings = verdict.warnings[:MOST_WARNINGS]
    if len(verdict.warnings) > MOST_WARNINGS:
        warnings = [*warnings, f"and {len(verdict.warnings) - MOST_WARNINGS} more in the report"]
    for heading, lines in (
        ("ruled out", [f"{count(verdict.cleared)}; the report has the bounds"] if verdict.cleared else []),
        ("not identifiable", [f"{count(verdict.unseen)}; the report says why"] if verdict.unseen else []),
        ("warnings", warnings),
        ("fly next", [summary.experiment] if summary.experiment else []),
    ):
        if lines:
            grid.add_row(Text(heading, style="dim"), Text("\n".join(lines)))
    return grid


def count(candidates: Sequence[object]) -> str:
    """So many candidates."""
    return f"{len(candidates)} candidate{'s' * (len(candidates) != 1)}"


def print_errors(console: Console, title: str, tables: Sequence[ErrorTable]) -> None:
    """Print errors over the horizon, before and after where there is an after, and the sensors' noise."""
    after = bool(tables[0].rows[0].after)
    table = Table(title=title, title_justify="left", show_edge=False, pad_edge=False)
    table.add_column("horizon")
    for entry in tables:
        table.add_column(f"{entry.quantity} [{entry.unit}]", justify="right")
    for i, row in enumerate(tables[0].rows):
        cells = [entry.rows[i] for entry in tables]
        table.add_row(row.horizon, *[f"{c.before} → {c.after}" if after else c.before for c in cells])
    if any(entry.noise for entry in tables):
        table.add_row(tables[0].noise_label, *[entry.noise for entry in tables], style="dim")
    console.print(table)


def print_beside(console: Console, twins: Mapping[str, Sequence[ErrorTable]]) -> None:
    """Print the errors of several twins side by side, a table for each quantity."""
    for entries in zip(*twins.values()):
        first = entries[0]
        title = f"{first.quantity} error [{first.unit}]"
        table = Table(title=title, title_justify="left", show_edge=False, pad_edge=False)
        table.add_column("horizon")
        for name in twins:
            table.add_column(name, justify="right", overflow="fold")
        for rows in zip(*(entry.rows for entry in entries)):
            table.add_row(rows[0].horizon, *(row.before for row in rows))
        if first.noise:
            table.add_row(first.noise_label, *(entry.noise for entry in entries), style="dim")
        console.print(table)
        console.print()
