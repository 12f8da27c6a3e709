"""What a job says of how far it is: a file beside its log, which whoever looks on reads while the job is under way."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...base.errors import InputError
from ...io.files import replacing


@dataclass(frozen=True)
class Said:
    """What a job says.

    Attributes
    ----------
    name : str
        Of what it is about.
    words : str
        What is done of it.
    seconds_left : float or None
        What it needs at least; None where it does not know.
    most_left : float or None
        What it needs at most; None where it does not know.
    """

    name: str
    words: str
    seconds_left: float | None = None
    most_left: float | None = None

    def __str__(self) -> str:
        return f"{self.name}: {self.words}"


def place(log: str | Path) -> Path:
    """The file beside a log."""
    path = Path(log)
    return path.with_name(f".{path.name}.now")


def say(log: str | Path, said: Said) -> None:
    """Put this in the place of what was said before; whoever reads meanwhile sees the one or the other.

    A disk that is full is no reason for a job to end: then nothing is said.
    """
    with contextlib.suppress(InputError, OSError), replacing(place(log), checksum=False) as temporary:
        temporary.write_text(json.dumps(asdict(said)), encoding="utf-8")


def saying(log: str | Path, name: str) -> Callable[[Any], None]:
    """What says how far something is, for diagnosis.core.how_far.HowFar."""
    return lambda how_far: say(log, Said(name, how_far.words, how_far.seconds_left, how_far.most_left))


def heard(log: str | Path, since: float) -> Said | None:
    """What a job says.

    Parameters
    ----------
    log : str or Path
        Of the job.
    since : float
        When it was started, s, of the epoch: a job that was killed leaves its last words.

    Returns
    -------
    Said or None
        None if it has said nothing since then.
    """
    path = place(log)
    try:
        if path.stat().st_mtime < since:
            return None
        return Said(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def silence(log: str | Path) -> None:
    """Take away what a job has said."""
    place(log).unlink(missing_ok=True)
