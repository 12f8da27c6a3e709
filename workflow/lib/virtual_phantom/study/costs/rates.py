"""Measured rates: core seconds per unit of work, and bytes per unit of output."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
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


def fit(measured: Iterable[tuple[Job, float]], stage_units: dict[str, Sequence[str]]) -> dict[str, dict[str, float]]:
    """Fit rates to measured times of jobs.

    The fit is a non-negative least-squares fit of relative errors, so that short jobs, which determine the start-up
    time, count as much as long ones. Rates of zero are omitted. For a stage with a single job and the units "job" and
    one other, the start-up time is the time of the shortest of all jobs.

    Parameters
    ----------
    measured : iterable of (Job, float)
        Jobs and their times, s.
    stage_units : dict of str to sequence of str
        Units of the rates of each stage; a stage without an entry has one rate per job.

    Returns
    -------
    dict of str to dict
        {stage: {unit: seconds}}.

    Raises
    ------
    InputError
        For any other stage with fewer jobs than units.
    """
    by_stage: dict[str, list[tuple[Job, float]]] = {}
    for job, took in measured:
        by_stage.setdefault(job.stage, []).append((job, took))
    rates = {}
    shortest = min(took for jobs in by_stage.values() for _, took in jobs)
    for stage, jobs in sorted(by_stage.items()):
        units = list(stage_units.get(stage, ["job"]))
        if len(jobs) == 1 and len(units) == 2:
            ((job, took),) = jobs
            rates[stage] = {"job": shortest, units[1]: (took - shortest) / job.work[units[1]]}
            continue
        if len(jobs) < len(units):
            raise InputError(f"{stage}: {len(jobs)} jobs are too few for the rates of {', '.join(units)}")
        work = np.array([[job.work[unit] / took for unit in units] for job, took in jobs])
        rates[stage] = _least_squares(work, np.ones(len(jobs)), units)
    return rates


def fit_parts(
    measured: Sequence[tuple[Mapping[str, float], Mapping[str, float]]], parts: Mapping[str, Sequence[str]]
) -> dict[str, float]:
    """Fit {unit: seconds} of one stage to jobs whose parts were timed separately.

    Non-negative least squares as in `fit`, of errors relative to the whole job, so that long parts count most.

    Parameters
    ----------
    measured : sequence of (mapping of str to float, mapping of str to float)
        {unit: amount} of a job, and {part: seconds}.
    parts : mapping of str to sequence of str
        {part: its units}.
    """
    units = [unit for of_part in parts.values() for unit in of_part]
    rows, shares = [], []
    for work, seconds in measured:
        whole = sum(seconds.values())
        for part, took in seconds.items():
            rows.append([work[unit] / whole if unit in parts[part] else 0.0 for unit in units])
            shares.append(took / whole)
    return _least_squares(np.array(rows), np.array(shares), units)


def _least_squares(work: np.ndarray, target: np.ndarray, units: Sequence[str]) -> dict[str, float]:
    from scipy.optimize import nnls  # slow import

    largest = work.max(axis=0)
    scale = np.where(largest > 0, largest, 1.0)  # avoids division by zero for units that no job has
    found, _ = nnls(work / scale, target)
    return {unit: float(rate) for unit, rate in zip(units, found / scale, strict=True) if rate > 0}
