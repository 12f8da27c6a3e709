"""Folders for cached files that can be computed again."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from .home import home_folder

NAME = "virtual_phantom"


def user_cache() -> Path | None:
    """Return the user's cache folder of this package: below ``$XDG_CACHE_HOME``, otherwise below ``~/.cache``.

    The folder may be missing or read-only. A relative ``$XDG_CACHE_HOME`` is ignored, as the XDG Base Directory
    Specification demands. The result is None if neither is known, or if the folder belongs to another user, who could
    have put machine code into it.
    """
    if os.path.isabs(stated := os.environ.get("XDG_CACHE_HOME", "")):
        folder = Path(stated, NAME)
    elif (home := home_folder()) is not None:
        folder = Path(home, ".cache", NAME)
    else:
        return None
    try:
        return folder if _is_own(folder.stat()) else None
    except OSError:  # missing
        return folder


def temporary_cache(make: bool = True) -> Path | None:
    """Return a folder for temporary files, kept between processes, that only this user can write to.

    With `make`, a missing folder is created. None if it is missing, cannot be created, or could contain files of
    another user. Cached machine code is executed, so a folder that others can write to must not be read.
    """
    try:
        user = os.getuid() if hasattr(os, "getuid") else 0
        folder = Path(tempfile.gettempdir()).absolute() / f"{NAME}-{user}"
        if make:
            folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = _is_own(found) and (os.name == "nt" or not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    return folder if stat.S_ISDIR(found.st_mode) and private else None


def _is_own(found: os.stat_result) -> bool:
    """Return whether a folder belongs to the user of this process; always true on Windows, where users share none."""
    return not hasattr(os, "getuid") or found.st_uid == os.getuid()
