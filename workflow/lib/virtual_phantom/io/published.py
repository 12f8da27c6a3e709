"""Files of others that a shipped configuration names: which they are, and whether they are those.

A table lists them: `file`, where each lies below FOLDER; `source`, where below a web folder it comes from; `sha256`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..base.errors import InputError
from .files import read_text, sha256

FOLDER = "downloads"  # in the project's folder; git ignores it


@dataclass(frozen=True)
class PublishedFile:
    """One file of others.

    Attributes
    ----------
    path : str
        Its path here.
    source : str
        Its path below the web folder.
    sha256 : str
        Of its bytes, hexadecimal.
    """

    path: str
    source: str
    sha256: str


def read_published(table: str | Path) -> tuple[PublishedFile, ...]:
    """The files of a table, a CSV."""
    rows = csv.DictReader(read_text(table).splitlines())
    return tuple(PublishedFile(f"{FOLDER}/{row['file']}", row["source"], row["sha256"]) for row in rows)


def named_by(paths: Iterable[str], files: Iterable[PublishedFile]) -> list[PublishedFile]:
    """Those files that are one of these paths or lie in one of these folders, in their own order."""
    named = {Path(path) for path in paths}
    return [file for file in files if named & {Path(file.path), *Path(file.path).parents}]


def check_listed(path: str | Path, digest: str, table: str | Path, advice: str) -> None:
    """Check that a file is the one that a table lists.

    Parameters
    ----------
    digest : str
        SHA-256 in the table, hexadecimal.
    table : str or Path
        The table, for the message.

    Raises
    ------
    InputError
        If the file's SHA-256 is another.
    """
    if (found := sha256(path)) != digest:
        raise InputError(f"{path}: is not the file that {table} lists (SHA-256 {found}, not {digest}); {advice}")


def reachable(url: str, advice: str) -> str:
    """The address of a file on the web, which has been asked for.

    Parameters
    ----------
    url, advice : str
        The address, and what to do where there is no network.

    Raises
    ------
    InputError
        If the file cannot be fetched.
    """
    import requests  # as what fetches the file does, Snakemake's plugin

    try:
        requests.head(url, timeout=20, allow_redirects=True).raise_for_status()
    except requests.RequestException as error:
        reason = "no connection" if error.response is None else error.response.reason
        raise InputError(f"{url} cannot be fetched ({reason}); {advice}") from None
    return url
