"""Measured rates: seconds of one core per unit of work, and bytes per unit of what is written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

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
        Naming the file, where it is missing, is not of this form or holds a negative rate.
    """
    try:
        rates = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path}: is not YAML ({' '.join(str(error).split())})") from None
    try:
        numbers = [*rates["bytes"].values(), *(rate for units in rates["seconds"].values() for rate in units.values())]
        sound = all(rate >= 0 for rate in numbers)
    except (TypeError, KeyError, AttributeError):
        sound = False
    if not sound:
        raise InputError(
            f"{path}: needs seconds (stage: {{unit: rate}}) and bytes (kind: rate), no rate under 0; write it again "
            "with python -m benchmarks run fit_rates"
        )
    return rates


def seconds(job: Job, rates: dict) -> float | None:
    """Estimated seconds of a job on one core; None if its stage has no measured rate."""
    return estimate(rates, job.stage, job.work)


def estimate(rates: dict, stage: str, work: Mapping[str, float]) -> float | None:
    """As `seconds`, of a stage and its work."""
    units = rates["seconds"].get(stage)
    return None if units is None else sum(rate * work[unit] for unit, rate in units.items())


def written(job: Job, rates: dict) -> float | None:
    """Estimated bytes of all files of a job; None if one of its kinds has no measured rate."""
    if any(kind not in rates["bytes"] for kind in job.writes):
        return None
    return sum(rates["bytes"][kind] * amount for kind, amount in job.writes.items())


def fit(measured: Iterable[tuple[Job, float]], stage_units: dict[str, Sequence[str]]) -> dict[str, dict[str, float]]:
    """Rates from jobs and the seconds that they took.

    Non-negative least squares of relative errors: short jobs tell a start-up time, and count as much as long ones.
    Rates that come out as zero are left out. Of a stage with one job, of "job" and another unit, start-up is taken to
    last as long as the shortest job of all.

    Parameters
    ----------
    measured : iterable of (Job, float)
        Jobs, and the seconds that each took.
    stage_units : dict of str to sequence of str
        The units that a stage's rates are fitted in; a stage that is not named has one rate per job.

    Returns
    -------
    dict of str to dict
        {stage: {unit: seconds}}.

    Raises
    ------
    InputError
        For a stage with fewer jobs than units otherwise.
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
    """Rates of one stage from jobs whose parts were timed, each of which has units of its own.

    Non-negative least squares as in `fit`, of errors relative to the whole job: parts that take longest count most.

    Parameters
    ----------
    measured : sequence of (mapping of str to float, mapping of str to float)
        {unit: amount} of a job, and {part: the seconds that it took}.
    parts : mapping of str to sequence of str
        {part: its units}.

    Returns
    -------
    dict of str to float
        {unit: seconds}.
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
    from scipy.optimize import nnls  # takes longer to import than all else that reading a workflow needs

    largest = work.max(axis=0)
    scale = np.where(largest > 0, largest, 1.0)  # nothing tells of what no job has
    found, _ = nnls(work / scale, target)
    return {unit: float(rate) for unit, rate in zip(units, found / scale, strict=True) if rate > 0}
