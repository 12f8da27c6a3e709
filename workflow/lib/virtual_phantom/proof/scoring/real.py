"""Real recordings that the page shows next to the cases. They are not scored, since their truth is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...base.errors import InputError
from ...io.files import check_unchanged
from ..hiding import seal
from .collect import complete

CORES = 2  # of the target in targets.MINUTES


def row(path: str | Path) -> dict:
    """Summarize a diagnosis.json.

    Raises
    ------
    InputError
        If it is broken.
    """
    check_unchanged(path, "diagnose it again")
    found = complete(seal.read(path), path)
    return {
        **{key: found[key] for key in ("recording", "verdict", "sentence")},
        "named": [effect["name"] for effect in found["effects"]],
        "ambiguous_with": {name: list(others) for name, others in found["ambiguous_with"].items()},
        "excess_rms_removed": found["excess_rms_removed"],
        "caveats": list(found.get("caveats", [])),
    }


def minutes(benchmarks: Sequence[str | Path]) -> float | None:
    """Return the duration of jobs from Snakemake's benchmarks on CORES cores, minutes; None without benchmarks.

    Raises
    ------
    InputError
        If a file is not a benchmark.
    """
    seconds = []
    for path in benchmarks:
        try:
            header, *lines = Path(path).read_text().splitlines()
            seconds += [float(line.split("\t")[header.split("\t").index("s")]) for line in lines]
        except (OSError, ValueError, IndexError):
            raise InputError(f"{path}: is not a benchmark of a job; delete it and run the job again") from None
    return sum(seconds) / 60 / CORES if seconds else None
