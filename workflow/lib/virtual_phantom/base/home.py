"""Paths that begin with ``~``: the one place where the home folder is put in."""

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
    """Replace a leading ``~`` or ``~user`` in text, and in all text within mappings and lists, as a shell does.

    Parameters
    ----------
    value : object
        Text, path, mapping, list or tuple; anything else is returned as it is.
    where : str, optional
        Key or option of the value, for the message.

    Returns
    -------
    object
        ``~name/...`` stays if there is no such user: it may name a folder.

    Raises
    ------
    InputError
        If there is no home folder.
    """
    if isinstance(value, Mapping):
        return {key: expand_home(one, f"{where}.{key}" if where else str(key)) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(expand_home(one, f"{where}.{place}") for place, one in enumerate(value))
    if isinstance(value, Path):
        return Path(expand_home(str(value), where))
    if not isinstance(value, str) or not value.startswith("~"):
        return value
    if (value == "~" or value.startswith("~/")) and home_folder() is None:
        begin = f"{where}: " if where else ""
        raise InputError(f"{begin}{value}: no home folder is known for ~; set HOME or write the whole path")
    return os.path.expanduser(value) if value == "~" or "/" in value else value


def expand_home_of_word(word: str) -> str:
    """Replace ``~`` in a word of a command line, also in ``--option=~/file``, where no shell does it."""
    option, equals, value = word.partition("=")
    if equals and option.startswith("--"):
        return f"{option}={expand_home(value, option)}"
    return expand_home(word)
