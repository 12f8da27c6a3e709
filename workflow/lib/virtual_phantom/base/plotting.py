"""Import of Matplotlib that does not fail because of the user's settings or folders."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
from collections.abc import Iterator

from .cache_folders import temporary_cache
from .errors import InputError
from .home import home_folder


def import_matplotlib() -> None:
    """Import Matplotlib with the user's settings or, if they prevent its import, without them.

    A notebook sets MPLBACKEND for all that it starts, also for a Python that lacks this backend. A matplotlibrc may be
    unreadable. In a container, or for a user without a home folder, no default folder can be written to.

    Raises
    ------
    InputError
        If Matplotlib finds no folder that it can write to.
    """
    if "matplotlib" in sys.modules:
        return
    # Matplotlib's own temporary folder is per process, so every process would collect all fonts again.
    if not all(map(_writable, _settings_folders())) and (temporary := temporary_cache()) is not None:
        os.environ["MPLCONFIGDIR"] = str(temporary / "matplotlib")
    try:
        import matplotlib  # noqa: F401
    except ValueError:  # an unknown backend, or a matplotlibrc that is not UTF-8
        os.environ.pop("MPLBACKEND", None)
        (package,) = importlib.util.find_spec("matplotlib").submodule_search_locations
        for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
            del sys.modules[name]  # parts of the import that failed
        with contextlib.chdir(os.path.join(package, "mpl-data")):  # a matplotlibrc here precedes all others
            import matplotlib  # noqa: F401
    except OSError:
        raise InputError("Matplotlib finds no folder to write to; set MPLCONFIGDIR to a writable folder") from None


def _settings_folders() -> Iterator[str]:
    """Yield the settings and font folders that Matplotlib is about to use (matplotlib._get_config_or_cache_dir)."""
    if stated := os.environ.get("MPLCONFIGDIR"):
        yield stated
    elif sys.platform.startswith("linux"):
        home = home_folder() or ""
        for variable, default in (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache")):
            yield os.path.join(os.environ.get(variable) or os.path.join(home, default), "matplotlib")


def _writable(folder: str) -> bool:
    """Return whether a folder exists or can be created, and is writable; False for a relative path."""
    if not os.path.isabs(folder):
        return False
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)
