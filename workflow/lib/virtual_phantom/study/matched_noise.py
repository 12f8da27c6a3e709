"""Noise levels that a study takes from a recording, between the job that finds them and those that use them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from ..base.errors import refusing
from ..io.files import read_text, write_text


def write(level: dict, path: str | Path) -> None:
    """Write a level, finite numbers and words under `A` and whatever else tells how it was found, as JSON."""
    write_text(json.dumps(level, indent=2, allow_nan=False) + "\n", path)


def read(path: str | Path) -> dict:
    """A level that `write` wrote.

    Raises
    ------
    InputError
        If the file is missing, changed or broken.
    """
    kinds = (OSError, ValueError, KeyError, TypeError)
    with refusing(f"{path}: is not a noise level", *kinds, advice="delete it and run again"):
        level = json.loads(read_text(path))
        level["A"] = float(level["A"])
    return level


def resolve(acquisitions: Iterable[dict], paths: Iterable[str | Path]) -> list[dict]:
    """Acquisitions whose `noise_level`, where it is None, is that of the file {noise}.json among `paths`."""
    found = {Path(path).stem: read(path)["A"] for path in paths}
    return [
        {**one, "noise_level": found[one["noise"]]} if one["noise_level"] is None else dict(one) for one in acquisitions
    ]
