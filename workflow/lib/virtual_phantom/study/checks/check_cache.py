"""Checks that found nothing wrong are not made again while settings, files and code stay as they are.

Each is a file named by a hash of everything that it depends on, in Snakemake's own folder: names of files and settings
do not go into it. It is empty unless the check made notes, and then `virtual-phantom check` makes it again.
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

SNAKEMAKE = Path(".snakemake")  # where it runs
FOLDER = SNAKEMAKE / "virtual_phantom"
MOST = 100  # that are kept, the newest
WITH_NOTES = b"notes"


def look_once(
    settings: Mapping, paths: Iterable[str | Path], look: Callable[[], Iterable[str]], keep: bool = False
) -> list[str]:
    """What a check finds; nothing at once, where it has found nothing before.

    Parameters
    ----------
    settings : mapping
        All that the check depends on beside files; JSON.
    paths : iterable of str or Path
        Files, and folders of files, that it reads. They count as changed with their size or time.
    look : callable
        The check: a line for each mistake.
    keep : bool, optional
        Make the folder where it is not there, and do not look again for the sake of notes.
    """
    try:
        kept = FOLDER / _mark(settings, paths)
        if kept.exists() and (keep or not kept.stat().st_size):
            return []
    except OSError:  # a file that is not there: the check says which
        return list(look())
    with collected_notes() as notes:
        lines = list(look())
    if not lines and (keep or SNAKEMAKE.is_dir()):
        with contextlib.suppress(OSError):  # where nothing may be written, the next start looks again
            FOLDER.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(WITH_NOTES if notes else b"")
            for old in sorted(FOLDER.iterdir(), key=lambda path: path.stat().st_mtime)[:-MOST]:
                old.unlink(missing_ok=True)
    return lines


def _mark(settings: Mapping, paths: Iterable[str | Path]) -> str:
    """A hash of settings, of the size and time of every file, and of those of the library's own code."""
    sources = [file for path in paths for file in files_of(path)]
    code = sorted(LIBRARY.rglob("*.py"))
    states = [(str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns) for file in (*sources, *code)]
    return hashlib.sha256(json.dumps([settings, states], sort_keys=True, default=str).encode()).hexdigest()
