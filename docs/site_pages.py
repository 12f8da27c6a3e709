"""Hooks of the documentation site (mkdocs.yml): pages that lie outside of docs/, and links between all of them.

In the repository links are relative to the file that they stand in, so that they work where the code is hosted. In the
site the folder docs/ is the root, and README.md, config/README.md and the like are pages beside its own.
"""

import re
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = "docs"
# Pages, and files that they link to, by their place in the repository; in the site they keep it.
OUTSIDE = (
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "LICENSE",
    "config/README.md",
    "workflow/lib/virtual_phantom/resources/README.md",
    "workflow/lib/virtual_phantom/resources/rates.yaml",
    "workflow/profiles/slurm/config.yaml",
)
LINK = re.compile(r"(\]\()(?![a-z]+:|#)([^)#\s]+)")


def on_files(files, config):
    """Add the files of OUTSIDE."""
    for place in OUTSIDE:
        files.append(File.generated(config, place, abs_src_path=str(ROOT / place)))
    return files


def on_page_markdown(markdown, page, **_):
    """Turn links relative to the file in the repository into links relative to the page in the site."""
    here = page.file.src_uri
    return LINK.sub(lambda match: match[1] + in_site(match[2], here), markdown)


def in_site(link: str, here: str) -> str:
    """A link of the page `here` (its place in the site) as the site needs it."""
    place = here if here in OUTSIDE else join(DOCS, here)
    target = normpath(join(dirname(place), link))
    return relpath(target.removeprefix(f"{DOCS}/"), dirname(here) or ".")
