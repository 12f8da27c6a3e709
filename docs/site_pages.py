"""Hooks of the documentation site (mkdocs.yml): pages from outside of docs/, generated pages, and links between pages.

In the repository, links are relative to the file that contains them, so that they work on a code host. In the site,
docs/ is the root, and README.md, config/README.md and similar pages keep their path in the repository.
"""

import base64
import csv
import re
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

import nbformat
from generators import PAGES
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
DOCS = "docs"
# Pages and linked files. The site has them at the same path as the repository.
OUTSIDE = (
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "LICENSE",
    "Dockerfile",
    "config/README.md",
    "workflow/lib/virtual_phantom/resources/README.md",
    "workflow/lib/virtual_phantom/resources/rates.yaml",
    "workflow/lib/virtual_phantom/schemas/config.schema.yaml",
    "workflow/profiles/slurm/config.yaml",
)
LINK = re.compile(r"(\]\()(?![a-z]+:|#)([^)#\s]+)")
TABLE = re.compile(r"^<!-- table: (\S+\.csv) -->$", re.MULTILINE)


def on_files(files, config):
    """Add the files of OUTSIDE, the generated pages, and a page with its figures for every notebook."""
    for path in OUTSIDE:
        files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    for path, page in PAGES.items():
        files.append(File.generated(config, path, content=page()))
    for path in sorted((ROOT / DOCS / "notebooks").glob("*.ipynb")):
        markdown, figures = notebook_page(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=markdown))
        for name, png in figures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=png))
    return files


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return a notebook with its outputs as Markdown, and its figures as {file name: content}."""
    parts, figures = [], {}
    for cell in nbformat.read(path, as_version=4).cells:
        parts.append(cell.source if cell.cell_type == "markdown" else f"```python\n{cell.source}\n```")
        for output in cell.get("outputs", ()):
            shown = output.get("data", {})
            if "image/png" in shown:
                name = f"{path.stem}_{len(figures) + 1}.png"
                figures[name] = base64.b64decode(shown["image/png"])
                parts.append(f"![Output of the code above]({name})")
            else:
                parts.append(f"```text\n{(output.get('text') or shown['text/plain']).rstrip()}\n```")
    parts.append(f"[This page as a notebook]({path.name})")
    return "\n\n".join(parts) + "\n", figures


def on_page_markdown(markdown, page, **_):
    """Insert CSV tables, and turn links relative to the file in the repository into links relative to the page."""
    here = page.file.src_uri
    folder = ROOT / DOCS / dirname(here)
    markdown = TABLE.sub(lambda match: markdown_table(folder / match[1]), markdown)
    if not here.startswith("notebooks/"):  # there a notebook is linked as a file; elsewhere its page is meant
        markdown = markdown.replace(".ipynb)", ".md)")
    return LINK.sub(lambda match: match[1] + in_site(match[2], here), markdown)


def markdown_table(path: Path) -> str:
    """Return a CSV file as a Markdown table."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def in_site(link: str, here: str) -> str:
    """Return a link relative to the page `here` (a path in the site)."""
    source = here if here in OUTSIDE else join(DOCS, here)
    target = normpath(join(dirname(source), link))
    return relpath(target.removeprefix(f"{DOCS}/"), dirname(here) or ".")
