"""The status of a running job: a small file next to its log, written by the job and read by the console."""

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
class JobStatus:
    """Status of one job.

    Attributes
    ----------
    name : str
        Name of the recording or scanner that the job works on.
    words : str
        Steps done so far, in words.
    min_seconds_left, max_seconds_left : float or None
        Lower and upper estimate of the remaining wall time, s; None if unknown.
    """

    name: str
    words: str
    min_seconds_left: float | None = None
    max_seconds_left: float | None = None

    def __str__(self) -> str:
        return f"{self.name}: {self.words}"


def status_path(log: str | Path) -> Path:
    """Return the path of the status file that belongs to a log."""
    path = Path(log)
    return path.with_name(f".{path.name}.now")


def write_status(log: str | Path, status: JobStatus) -> None:
    """Replace the status of a job in one step, so that readers never see half a file.

    A full disk does not stop the job: the status is then not written.
    """
    with contextlib.suppress(InputError, OSError), replacing(status_path(log), checksum=False) as temporary:
        temporary.write_text(json.dumps(asdict(status)), encoding="utf-8")


def status_writer(log: str | Path, name: str) -> Callable[[Any], None]:
    """Return a callback for `diagnosis.selection.progress.DiagnosisProgress` that writes the status of a job."""
    return lambda progress: write_status(
        log, JobStatus(name, progress.words, progress.min_seconds_left, progress.max_seconds_left)
    )


def read_status(log: str | Path, since: float) -> JobStatus | None:
    """Read the status of a job; None if it has written none since its start (s since the epoch).

    An older file is left over from a job that was killed.
    """
    path = status_path(log)
    try:
        if path.stat().st_mtime < since:
            return None
        return JobStatus(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def remove_status(log: str | Path) -> None:
    """Remove the status of a job."""
    status_path(log).unlink(missing_ok=True)
