"""The documentation site as `make docs` builds it works opened from disk, and asks nothing of the network."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.viz.browser import Browser

pytest.importorskip("mkdocs")
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, every warning an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def test_pages_stand_alone(site: Path) -> None:
    """No link to a folder, which a browser would list, none to what is not there."""
    wrong = []
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for link in re.findall(r'(?:href|src)="([^"#?]+)[^"]*"', text):
            address = urlsplit(link)
            if not address.scheme and page.name != "404.html" and not (page.parent / unquote(address.path)).is_file():
                wrong.append((page.name, link))
    assert wrong == []
    # Equations of effects read as they are.
    assert "<code>-mu |N| sgn(v)</code>" in (site / "effects.html").read_text(encoding="utf-8")
    # Scripts, styles, fonts and pictures lie in the site.
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert re.findall(r'<(?:script|link|img|iframe)\b[^>]*(?:src|href)="(?:https?:)?//[^"]*"', text) == []


@pytest.mark.browser
def test_the_search_works_from_disk(site: Path, tmp_path: Path) -> None:
    """A word is found, and its first result is a page that opens."""
    with Browser(tmp_path / "profile") as browser:
        browser.open(site / "index.html")
        browser.evaluate("document.querySelector('label[for=__search]').click(); 0")
        typed = "i = document.querySelector('.md-search__input'); i.focus(); i.value = 'backlash';"
        found = "document.querySelector('.md-search-result__link')?.href ?? ''"
        deadline = time.monotonic() + 30.0
        while not (link := browser.evaluate(found)):
            assert time.monotonic() < deadline
            browser.evaluate(f"{typed} i.dispatchEvent(new KeyboardEvent('keyup', {{bubbles: true}})); 0")
            time.sleep(0.2)
        assert Path(unquote(urlsplit(link).path)).is_file()
        assert all(url.startswith(("file:", "data:", "about:", "blob:")) for url in browser.requests)


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_is_cut_off(site: Path, tmp_path: Path, width: int) -> None:
    """No page is wider than the screen; a table that is wider scrolls by itself."""
    with Browser(tmp_path / "profile", size=(width, 900), dark=True) as browser:
        for page in sorted(site.glob("*.html")):
            browser.open(page)
            assert browser.evaluate("document.documentElement.scrollWidth") <= width, page.name
            cut = (
                "[...document.querySelectorAll('pre, table')].filter(e => e.checkVisibility()"
                " && e.getBoundingClientRect().right > innerWidth + 1 && !e.closest('.md-typeset__scrollwrap')).length"
            )
            assert browser.evaluate(cut) == 0, page.name
