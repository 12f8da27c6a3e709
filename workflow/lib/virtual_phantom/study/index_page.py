"""Update of the index page after every run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from .pages import Pages


def renew(pages: Pages, config: Mapping) -> Path | None:
    """Write the index page again if a diagnosis or another page is newer than it.

    Diagnoses and other pages have their own targets. They are no inputs of the index page, because every study would
    then make them.

    Parameters
    ----------
    config : mapping
        Complete configuration.

    Returns
    -------
    Path or None
        None if the page is up to date or the study has not been run.

    Raises
    ------
    InputError
        For a file that cannot be read or written.
    """
    target = Path(pages.files("index"))
    pictures, tables = (list(map(Path, paths)) for paths in (pages.pictures(), pages.tables()))
    shown = [*pages.diagnoses(), *(target.parent / address for address in pages.existing_pages().values())]
    if not shown or not all(path.exists() for path in (*pictures, *tables)):
        return None
    if target.exists() and max(Path(path).stat().st_mtime for path in shown) <= target.stat().st_mtime:
        return None
    from ..io.files import write_text
    from ..report import index, study  # slow import

    html = index.index_page(
        target.parent,
        study.report_figures(pictures, pages.caption_files(), pages.figures()),
        list(zip(pages.table_titles(), tables, strict=True)),
        list(map(Path, pages.diagnoses())),
        config,
        pages.commands(),
        pages.existing_pages(),
        pages.setting_pairs(),
        pages.impossible(),
    )
    write_text(html, target)
    return target
