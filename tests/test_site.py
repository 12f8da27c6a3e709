"""The documentation as a site, and its links both there and where the code is hosted."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PLACES = ("docs/**/*.md", "*.md", "config/*.md", "workflow/**/*.md")
PAGES = sorted(page for place in PLACES for page in ROOT.glob(place))
FETCHED = re.compile(
    r"""<(?:script|img|iframe)[^>]*src="(?:https?:)?//|<link[^>]*rel="stylesheet"[^>]*href="(?:https?:)?//"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, and what building it printed."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    return folder, process


def test_it_is_built_without_a_warning(site):
    _, process = site
    assert process.returncode == 0, process.stderr
    assert "WARNING" not in process.stderr and "ERROR" not in process.stderr, process.stderr


def test_every_page_is_in_it(site):
    folder, _ = site
    for page in PAGES:
        place = page.relative_to(ROOT / "docs") if (ROOT / "docs") in page.parents else page.relative_to(ROOT)
        name = "index.html" if place.name == "README.md" else f"{place.stem}.html"
        assert (folder / place.parent / name).stat().st_size > 5000, place


def test_it_fetches_nothing_from_elsewhere(site):
    folder, _ = site
    for page in folder.rglob("*.html"):
        assert not FETCHED.search(page.read_text(encoding="utf-8")), page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_files_lead_somewhere(page):
    """Relative to the file, as a code host takes them; the site's own links are checked when it is built."""
    for target in re.findall(r"\]\((?![a-z]+:|#)([^)#\s]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target
