"""Lists on the command line: `5,spleen`, quoted as in CSV where a name has a comma."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping

from ...base.errors import InputError


def listed(values: Iterable[str], option: str) -> list[str]:
    """Entries of an option that may be given several times, each time with a list.

    Parameters
    ----------
    values : iterable of str
        What was given, such as `5,"GTV, left"`.
    option : str
        For the message.

    Returns
    -------
    list of str
        Without empty ones.

    Raises
    ------
    InputError
        For a quotation mark that is not closed.
    """
    found: list[str] = []
    for value in values:
        if value.count('"') % 2:
            raise InputError(f"{option}: {value!r} has a quotation mark that is not closed; close it, or double it")
        for row in csv.reader([value], skipinitialspace=True):
            found += [one.strip() for one in row if one.strip()]
    return found


def paired(values: Iterable[str]) -> dict[str, str]:
    """Names of labels.

    Parameters
    ----------
    values : iterable of str
        What was given to --names, such as `5=liver,"GTV, left"=gtv`. New names have no "=", labels of a file may.

    Returns
    -------
    dict of str to str
        {label: name}.

    Raises
    ------
    InputError
        For what is not LABEL=NAME, and a label that is named twice.
    """
    pairs: dict[str, str] = {}
    for part in listed(values, "--names"):
        label, equals, name = (one.strip() for one in part.rpartition("="))
        if not (label and equals and name):
            raise InputError(f"--names: '{part}' is not LABEL=NAME; give pairs such as 5=liver,1=spleen")
        if label in pairs:
            raise InputError(f"--names: names the label {label} twice; give it one name")
        pairs[label] = name
    return pairs


def joined(entries: Iterable[str] | Mapping[str, str]) -> str:
    """One value from which `listed` or `paired` reads these entries."""
    if isinstance(entries, Mapping):
        entries = [f"{label}={name}" for label, name in entries.items()]
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(entries)
    return text.getvalue()
