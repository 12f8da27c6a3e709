"""Measured rates: core seconds per unit of work, and bytes per unit of output."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from ...base.data import shipped_yaml
from ...base.errors import InputError
from .jobs import Job


def read_rates(path: str | Path) -> dict:
    """Read a file of rates.

    Returns
    -------
    dict
        {measured: {...}, seconds: {stage: {unit: s}}, bytes: {kind: bytes per unit}}.

    Raises
    ------
    InputError
        If the file is missing, has another form or a negative rate.
    """
    try:
        rates = shipped_yaml(Path(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path}: is not YAML ({' '.join(str(error).split())})") from None
    try:
        numbers = [*rates["bytes"].values(), *(rate for units in rates["seconds"].values() for rate in units.values())]
        valid = all(rate >= 0 for rate in numbers)
    except (TypeError, KeyError, AttributeError):
        valid = False
    if not valid:
        raise InputError(
            f"{path}: needs seconds (stage: {{unit: rate}}) and bytes (kind: rate), no rate under 0; write it again "
            "with python -m benchmarks run fit_rates"
        )
    return rates


def seconds(job: Job, rates: dict) -> float | None:
    """Estimate the core seconds of a job; None if its stage has no measured rate."""
    return estimate(rates, job.stage, job.work)


def estimate(rates: dict, stage: str, work: Mapping[str, float]) -> float | None:
    """Estimate the core seconds of work of a stage; None if the stage has no measured rate."""
    units = rates["seconds"].get(stage)
    return None if units is None else sum(rate * work[unit] for unit, rate in units.items())


def written_bytes(job: Job, rates: dict) -> float | None:
    """Estimate the bytes of all files of a job; None if a kind of file has no measured rate."""
    if any(kind not in rates["bytes"] for kind in job.writes):
        return None
    return sum(rates["bytes"][kind] * amount for kind, amount in job.writes.items())
