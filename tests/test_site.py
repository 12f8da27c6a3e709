"""Documentation site, and links that work both on the site and on a code host."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from generators import PAGES as GENERATED

ROOT = Path(__file__).resolve().parents[1]
PLACES = ("docs/**/*.md", "*.md", "config/*.md", "workflow/**/*.md")
PAGES = sorted(page for place in PLACES for page in ROOT.glob(place))
FETCHED = re.compile(
    r"""<(?:script|img|iframe)[^>]*src="(?:https?:)?//|<link[^>]*rel="stylesheet"[^>]*href="(?:https?:)?//"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site and its build output."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "workflow" / "lib")}
    process = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)
    return folder, process


def test_site_is_built_without_a_warning(site):
    _, process = site
    assert process.returncode == 0, process.stderr
    assert "WARNING" not in process.stderr and "ERROR" not in process.stderr, process.stderr


def test_site_has_every_page(site):
    folder, _ = site
    inside = [page.relative_to(ROOT / "docs" if (ROOT / "docs") in page.parents else ROOT) for page in PAGES]
    for path in [*inside, *map(Path, GENERATED)]:
        name = "index.html" if path.name == "README.md" else f"{path.stem}.html"
        assert (folder / path.parent / name).stat().st_size > 5000, path


def test_site_loads_no_external_resources(site):
    folder, _ = site
    for page in folder.rglob("*.html"):
        assert not FETCHED.search(page.read_text(encoding="utf-8")), page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_files_resolve(page):
    """Links are relative to the file, as on a code host. The build of the site checks its own links."""
    generated = {ROOT / "docs" / path for path in GENERATED}
    for target in re.findall(r"\]\((?![a-z]+:|#)([^)#\s]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists() or (page.parent / target).resolve() in generated, target
