"""Published files that a shipped configuration uses, and checks of their content.

A table lists them: `file`, the path below `resources_folder`; `source`, the path below a web folder; and `sha256`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..base.errors import InputError
from .files import read_text, sha256

FOLDER = "resources"  # in the folder of the study; git ignores its content
OLD_FOLDER = "downloads"  # its former name, accepted for one release
FETCHED = ("abdomen_ct", "printed_phantom")  # subfolders for fetched files


@dataclass(frozen=True)
class PublishedFile:
    """A published file.

    Attributes
    ----------
    path : str
        Local path.
    source : str
        Path below the web folder.
    sha256 : str
        Hexadecimal.
    """

    path: str
    source: str
    sha256: str


def resources_folder() -> str:
    """Return the folder for files that are fetched or that users add: `downloads` if only there files were fetched."""

    def used(folder):
        return any(Path(folder, name).exists() for name in FETCHED)

    return OLD_FOLDER if used(OLD_FOLDER) and not used(FOLDER) else FOLDER


def read_published(table: str | Path) -> tuple[PublishedFile, ...]:
    """Return the files that a CSV table lists."""
    folder = resources_folder()
    rows = csv.DictReader(read_text(table).splitlines())
    return tuple(PublishedFile(f"{folder}/{row['file']}", row["source"], row["sha256"]) for row in rows)


def named_by(paths: Iterable[str], files: Iterable[PublishedFile]) -> list[PublishedFile]:
    """Return the files that are among these paths or in these folders, in the order of `files`."""
    named = {Path(path) for path in paths}
    return [file for file in files if named & {Path(file.path), *Path(file.path).parents}]


def check_listed(path: str | Path, digest: str, table: str | Path, advice: str) -> None:
    """Check that a file has the SHA-256 that a table lists.

    Raises
    ------
    InputError
        If the file's SHA-256 differs.
    """
    if (found := sha256(path)) != digest:
        raise InputError(f"{path}: is not the file that {table} lists (SHA-256 {found}, not {digest}); {advice}")


def require_reachable(url: str, advice: str) -> str:
    """Return the address of a file on the web if a request for it succeeds; `advice` is for users without a network.

    Raises
    ------
    InputError
        If the file cannot be fetched.
    """
    import requests  # like Snakemake's plugin, which fetches the file

    try:
        requests.head(url, timeout=20, allow_redirects=True).raise_for_status()
    except requests.RequestException as error:
        reason = "no connection" if error.response is None else error.response.reason
        raise InputError(f"{url} cannot be fetched ({reason}); {advice}") from None
    return url
