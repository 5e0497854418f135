"""The site shows what lies outside docs too: README and the like, examples, and the files that pages link to.

Pages keep links that work where they lie in the repository; here they are turned to where things lie on the site.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

WIDE = re.compile(r"^\|(?:[^|\n]*\|){10}", re.MULTILINE)  # a table that takes the width of the navigation too
CODE = re.compile(r"`[^`\n]*`")  # in tables other readers need a backslash before its bars, this one shows it
ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(\]\()([^)#\s:]+)((?:#[^)\s]*)?\))")


def list_outside() -> list[str]:
    """Paths, relative to the repository, of pages outside docs and of all that pages link to outside docs."""
    examples = [page.relative_to(ROOT).as_posix() for page in ROOT.glob("examples/*/README.md")]
    pages = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", *examples]
    found, unread = set(pages), [*pages, *(p.relative_to(ROOT).as_posix() for p in ROOT.glob("docs/**/*.md"))]
    while unread:
        page = unread.pop()
        for _, link, _ in LINK.findall((ROOT / page).read_text(encoding="utf-8")):
            target = posixpath.normpath(posixpath.join(posixpath.dirname(page), link))
            if not target.startswith("docs/") and (ROOT / target).is_file() and target not in found:
                found.add(target)
                unread += [target] if target.endswith(".md") else []
    return sorted(found)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what lies outside docs."""
    for path in list_outside():
        files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to where things lie on the site: docs is its root, a folder is its README; bars in code are bars."""
    if WIDE.search(markdown):
        page.meta["hide"] = ["navigation", "toc"]
    here = page.file.src_uri
    home = here if page.file.generated_by else posixpath.join("docs", here)

    def turn(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(home), match[2]))
        if (ROOT / target).is_dir():
            target = posixpath.join(target, "README.md")
        site = target.removeprefix("docs/")
        return f"{match[1]}{posixpath.relpath(site, posixpath.dirname(here) or '.')}{match[3]}"

    return CODE.sub(lambda match: match[0].replace("\\|", "|"), LINK.sub(turn, markdown))
