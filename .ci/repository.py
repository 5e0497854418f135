"""Write where the repository lies into the package's metadata, README, citation and site: `make repository URL=...`.

An empty URL takes it out again.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACES = {
    "pyproject.toml": ("[project.urls]", 'Repository = "{}"\nIssues = "{}/issues"'),
    "CITATION.cff": ("license: Apache-2.0", 'repository-code: "{}"'),
    "mkdocs.yml": ("docs_dir: docs", "repo_url: {}"),
    "README.md": ("<!--repository-->", "Source: <{}>."),
}
"""File → the line behind which it stands, and as what."""


def fill(text: str, anchor: str, lines: str, url: str) -> str:
    """A text with an address behind a line, in the place of any that was there."""
    assert text.count(f"{anchor}\n") == 1, anchor
    known = "[^\n]*".join(map(re.escape, lines.split("{}")))
    text = re.sub(rf"(?<={re.escape(anchor)}\n){known}\n", "", text)
    return text.replace(f"{anchor}\n", f"{anchor}\n{lines.replace('{}', url)}\n") if url else text


def write(url: str, root: Path = ROOT) -> None:
    """Write an address into all places of a checkout."""
    if url and not re.fullmatch(r"https://[^\s\"<>]+[^\s\"<>/]", url):
        sys.exit(f"{url}: expected an address such as https://github.com/NAME/vpptwin, without a slash at its end")
    for name, (anchor, lines) in PLACES.items():
        file = root / name
        file.write_text(fill(file.read_text(encoding="utf-8"), anchor, lines, url), encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1] if len(sys.argv) > 1 else "")
