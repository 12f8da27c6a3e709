"""Cache of successful checks, so that they run again only after a change of settings, files or code.

Each check is a file in Snakemake's folder, named by a hash of all its inputs. The file is empty unless the check
printed notes; `virtual-phantom check` then repeats the check.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from ...base.console import collected_notes
from ...config.dependencies import LIBRARY
from ...io.files import files_of

SNAKEMAKE = Path(".snakemake")  # in the working folder
FOLDER = SNAKEMAKE / "virtual_phantom"
MOST = 100  # checks to keep; older ones are deleted
WITH_NOTES = b"notes"


def cached_check(
    settings: Mapping, paths: Iterable[str | Path], check: Callable[[], Iterable[str]], keep: bool = False
) -> list[str]:
    """Return the errors that a check finds, or none if the cache holds the successful check.

    Parameters
    ----------
    settings : mapping
        Inputs of the check other than files; JSON.
    paths : iterable of str or Path
        Files and folders that the check reads. A changed size or time counts as a change.
    check : callable
        Returns a line for each error.
    keep : bool, optional
        Create the cache folder if it is missing, and do not repeat a check that printed notes.
    """
    try:
        entry = FOLDER / _key(settings, paths)
        if entry.exists() and (keep or not entry.stat().st_size):
            return []
    except OSError:  # a missing file, which the check reports
        return list(check())
    with collected_notes() as notes:
        lines = list(check())
    if not lines and (keep or SNAKEMAKE.is_dir()):
        with contextlib.suppress(OSError):  # in a read-only folder the check is repeated
            FOLDER.mkdir(parents=True, exist_ok=True)
            entry.write_bytes(WITH_NOTES if notes else b"")
            for old in sorted(FOLDER.iterdir(), key=lambda path: path.stat().st_mtime)[:-MOST]:
                old.unlink(missing_ok=True)
    return lines


def _key(settings: Mapping, paths: Iterable[str | Path]) -> str:
    """Return a hash of the settings and of size and time of all files and of the library's code."""
    sources = [file for path in paths for file in files_of(path)]
    code = sorted(LIBRARY.rglob("*.py"))
    states = [(str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns) for file in (*sources, *code)]
    return hashlib.sha256(json.dumps([settings, states], sort_keys=True, default=str).encode()).hexdigest()
