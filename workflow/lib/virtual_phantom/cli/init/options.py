"""Parse lists in options of `virtual-phantom init`, such as `5,spleen`. Names with commas are quoted as in CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping

from ...base.errors import InputError


def parse_list(values: Iterable[str], option: str) -> list[str]:
    """Return the non-empty entries of an option that may be repeated, each time with a list such as `5,"GTV, left"`.

    Raises
    ------
    InputError
        For a quotation mark that is not closed.
    """
    entries: list[str] = []
    for value in values:
        if value.count('"') % 2:
            raise InputError(f"{option}: {value!r} has a quotation mark that is not closed; close it, or double it")
        for row in csv.reader([value], skipinitialspace=True):
            entries += [entry.strip() for entry in row if entry.strip()]
    return entries


def parse_pairs(values: Iterable[str]) -> dict[str, str]:
    """Return {label: name} from values of --names, such as `5=liver,"GTV, left"=gtv`.

    Labels may contain "=", names may not.

    Raises
    ------
    InputError
        For an entry that is not LABEL=NAME, and for a label with two names.
    """
    pairs: dict[str, str] = {}
    for part in parse_list(values, "--names"):
        label, equals, name = (piece.strip() for piece in part.rpartition("="))
        if not (label and equals and name):
            raise InputError(f"--names: '{part}' is not LABEL=NAME; give pairs such as 5=liver,1=spleen")
        if label in pairs:
            raise InputError(f"--names: the label {label} has two names; give it one")
        pairs[label] = name
    return pairs


def format_list(entries: Iterable[str] | Mapping[str, str]) -> str:
    """Return one value from which `parse_list` or `parse_pairs` reads these entries."""
    if isinstance(entries, Mapping):
        entries = [f"{label}={name}" for label, name in entries.items()]
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(entries)
    return text.getvalue()
