"""Files of noise levels that are matched to a recording."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from ..base.errors import refusing
from ..io.files import read_text, write_text


def write_level(level: dict, path: str | Path) -> None:
    """Write a noise level as JSON: `A` and further finite numbers and texts that document the match."""
    write_text(json.dumps(level, indent=2, allow_nan=False) + "\n", path)


def read_level(path: str | Path) -> dict:
    """Read a noise level that `write_level` wrote.

    Raises
    ------
    InputError
        If the file is missing, changed or invalid.
    """
    kinds = (OSError, ValueError, KeyError, TypeError)
    with refusing(f"{path}: is not a noise level", *kinds, advice="delete it and run again"):
        level = json.loads(read_text(path))
        level["A"] = float(level["A"])
    return level


def resolve(acquisitions: Iterable[dict], paths: Iterable[str | Path]) -> list[dict]:
    """Return acquisitions with each missing `noise_level` read from the file {noise}.json among `paths`."""
    levels = {Path(path).stem: read_level(path)["A"] for path in paths}
    return [
        {**settings, "noise_level": levels[settings["noise"]]} if settings["noise_level"] is None else dict(settings)
        for settings in acquisitions
    ]
