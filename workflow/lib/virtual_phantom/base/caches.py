"""Folders for what is kept from one process to the next and can be computed again."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from .home import home_folder

NAME = "virtual_phantom"


def user_cache() -> Path | None:
    """Return the user's cache folder of this package: below ``$XDG_CACHE_HOME``, otherwise below ``~/.cache``.

    Returns
    -------
    Path or None
        It may be missing or read-only. None if there is no home folder. A relative ``$XDG_CACHE_HOME`` is ignored, as
        the XDG Base Directory Specification demands.
    """
    if os.path.isabs(stated := os.environ.get("XDG_CACHE_HOME", "")):
        return Path(stated, NAME)
    return Path(home, ".cache", NAME) if (home := home_folder()) is not None else None


def temporary_cache(make: bool = True) -> Path | None:
    """Return a folder for temporary files that only this user can write to, kept between processes.

    Parameters
    ----------
    make : bool, optional
        Create the folder if it is missing.

    Returns
    -------
    Path or None
        None if it is missing, cannot be made, or could contain files of another user. Cached machine code is executed,
        so that a folder that others can write to must not be read.
    """
    try:
        user = os.getuid() if hasattr(os, "getuid") else 0  # Windows has a folder for temporary files per user
        folder = Path(tempfile.gettempdir()).absolute() / f"{NAME}-{user}"
        if make:
            folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = found.st_uid == user and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if stat.S_ISDIR(found.st_mode) and (private or os.name == "nt") else None
