"""README, docs, help texts and report templates use plain words and short sentences, and keep to their length."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vpptwin.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[1]
PATTERNS = [
    (re.compile(pattern, re.IGNORECASE), instead)
    for pattern, instead in (
        line.split("\t")
        for line in (ROOT / "tests/words.txt").read_text(encoding="utf-8").splitlines()
        if line and not line.startswith("# ")
    )
]
QUOTING = {"docs/refusals.md", "docs/criteria.md", "docs/effects.md", "docs/benchmarks.md"}
"""Pages that list what the program prints."""
MOST_WORDS = {"README.md": 900, "docs/diagnose.md": 1500, "CHANGELOG.md": 3000}
MOST_DOCS = 35_000
"""Words of docs, README and examples together; bars and rules of tables are none."""
MOST_LINES = {"CHANGELOG.md": 300}
MOST_IN_SENTENCE, MEAN_IN_SENTENCE = 30, 16.0
WITHOUT_FLIGHTS = ("docs/diagnose.md", "docs/inference.md", "docs/history.md", "docs/verdict.md", "docs/limits.md")
"""Pages about any rig: most do not fly."""
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("*.md", "docs/*.md", "docs/tutorials/*.md", "examples/*/README.md")
    for path in ROOT.glob(pattern)
)
TEMPLATES = sorted(
    path.relative_to(ROOT).as_posix() for part in ("report", "drift") for path in ROOT.glob(f"vpptwin/{part}/**/*.j2")
)


def read(page: str) -> str:
    """A file of the repository."""
    return (ROOT / page).read_text(encoding="utf-8")


def strip_code(text: str) -> str:
    """A page without what programs read or print, and without where links lead."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^ {4}(?! *[-*\d]).*$", "", text, flags=re.MULTILINE)
    return re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`\n]*`", "code", text))


def list_sentences(text: str) -> list[str]:
    """Sentences of paragraphs and items; tables, headings and pictures are none."""
    found = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.)\s)", strip_code(text)):
        lines = [line for line in block.splitlines() if not line.startswith(("|", "#", "![", "<", "**Imports"))]
        found += re.split(r"(?<=[.!?:;])\s+", re.sub(r"[*\[\]]", "", " ".join(lines)))
    return [sentence for sentence in found if sentence.strip()]


def count_words(sentence: str) -> int:
    """Words with a letter or a digit."""
    return sum(any(c.isalnum() for c in word) for word in sentence.split())


def find_words(text: str) -> list[str]:
    """What is written that should not be, with what to write instead."""
    return [f"{match[0]!r}: write {instead}" for pattern, instead in PATTERNS for match in pattern.finditer(text)]


@pytest.mark.parametrize("page", [page for page in PAGES if page not in QUOTING])
def test_pages_use_plain_words(page: str) -> None:
    """None of tests/words.txt outside of code."""
    assert find_words(strip_code(read(page))) == []


@pytest.mark.parametrize("page", [page for page in PAGES if page not in QUOTING])
def test_sentences_are_short(page: str) -> None:
    """One thought a sentence."""
    lengths = {sentence: count_words(sentence) for sentence in list_sentences(read(page))}
    assert [sentence for sentence, words in lengths.items() if words > MOST_IN_SENTENCE] == []
    assert sum(lengths.values()) <= MEAN_IN_SENTENCE * max(len(lengths), 1)


def test_pages_are_short() -> None:
    """So that somebody reads them."""
    assert {page: words for page in MOST_WORDS if (words := len(read(page).split())) > MOST_WORDS[page]} == {}
    assert {page: lines for page in MOST_LINES if (lines := read(page).count("\n")) > MOST_LINES[page]} == {}
    docs = {page for page in PAGES if page != "CHANGELOG.md"}
    assert sum(count_words(read(page)) for page in docs) <= MOST_DOCS


@pytest.mark.parametrize("page", WITHOUT_FLIGHTS)
def test_what_does_not_fly_has_no_flights(page: str) -> None:
    """A cart has runs and logs."""
    assert re.findall(r"\bflights?\b", strip_code(read(page))) == []


@pytest.mark.parametrize("template", TEMPLATES)
def test_reports_use_plain_words(template: str) -> None:
    """Text between tags, without what is filled in."""
    text = re.sub(r"<style>.*?</style>|\{[%{#].*?[%}#]\}|<[^>]*>", " ", read(template), flags=re.DOTALL)
    assert find_words(text) == []
    assert re.findall(r"\bflights?\b", text) == []


def test_help_uses_plain_words() -> None:
    """Of every command."""
    parser = build_parser()
    (commands,) = (action.choices for action in parser._actions if isinstance(action.choices, dict))
    told = [parser.format_help(), *(command.format_help() for name, command in commands.items() if name != "train")]
    assert find_words("\n".join(told)) == []


@pytest.mark.parametrize("page", PAGES)
def test_tables_are_rectangular(page: str) -> None:
    """Every row has as many cells as the head, and no blank line or text breaks a table in two."""
    text = re.sub(r"^```.*?^```", "", read(page), flags=re.DOTALL | re.MULTILINE)
    for table in re.findall(r"(?:^\|.*(?:\n|$))+", text, flags=re.MULTILINE):
        head, rule, *rows = table.splitlines()
        assert re.fullmatch(r"\|(?:\s*:?-+:?\s*\|)+", rule), table
        assert [row for row in (rule, *rows) if count_cells(row) != count_cells(head)] == []


def count_cells(row: str) -> int:
    """Bars that part cells, of a row of a table."""
    return len(re.findall(r"(?<!\\)\|", row))


def test_nothing_that_a_stranger_reads_names_what_only_its_makers_have() -> None:
    """Pages, notebooks, examples and the package: no folder of ours, no number of an issue."""
    inner = re.compile(r"\.\./shared|/work/|\bSPEC(\.md)?\b(?!_)|\bissue #?\d")
    files = [ROOT / page for page in PAGES]
    for folder, kinds in (("vpptwin", "py j2 html yaml"), ("examples", "py yaml ipynb xml"), ("docs", "md")):
        files += [file for kind in kinds.split() for file in (ROOT / folder).rglob(f"*.{kind}")]
    found = {file.name: match[0] for file in files if (match := inner.search(file.read_text(encoding="utf-8")))}
    assert found == {}
