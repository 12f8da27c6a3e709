"""Expansion of ``~`` in paths."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from .errors import InputError


def home_folder() -> str | None:
    """Return the user's home folder; None if HOME is empty, or unset for a user that the system does not know."""
    home = os.path.expanduser("~")
    return home if os.path.isabs(home) and os.environ.get("HOME") != "" else None


def expand_home(value, where: str = ""):
    """Expand a leading ``~`` or ``~user`` in text, and in all text of mappings and lists, as a shell does.

    ``~name/...`` is unchanged if there is no such user: it may be a folder name. Messages begin with `where`, the key
    or option.

    Raises
    ------
    InputError
        If there is no home folder.
    """
    if isinstance(value, Mapping):
        return {key: expand_home(item, f"{where}.{key}" if where else str(key)) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(expand_home(item, f"{where}.{place}") for place, item in enumerate(value))
    if isinstance(value, Path):
        return Path(expand_home(str(value), where))
    if not isinstance(value, str) or not value.startswith("~"):
        return value
    if (value == "~" or value.startswith("~/")) and home_folder() is None:
        begin = f"{where}: " if where else ""
        raise InputError(f"{begin}{value}: no home folder is known for ~; set HOME or write the whole path")
    return os.path.expanduser(value) if value == "~" or "/" in value else value


def expand_home_of_word(word: str) -> str:
    """Expand ``~`` in a command-line argument, including ``--option=~/file``, which shells do not expand."""
    option, equals, value = word.partition("=")
    if equals and option.startswith("--"):
        return f"{option}={expand_home(value, option)}"
    return expand_home(word)
