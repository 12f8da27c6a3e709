"""Fit the rates of rates.yaml, by which `snakemake plan` estimates costs, to a completed study (seconds).

Times come from Snakemake's metadata, sizes from the files in the results. Run it after config/paper_groups.yaml on an
idle machine. To include noisy projections, run the study with `--config keep_projections=True` and some of these files
as targets. Rates of stages that the study does not have stay. Prints measured and estimated totals per stage.
"""

import base64
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import nnls

from benchmarks import common
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.io.files import write_text
from virtual_phantom.study.costs.jobs import Job, study_jobs
from virtual_phantom.study.costs.rates import read_rates, seconds

# Units of the rates per stage; other stages have seconds per job.
STAGE_UNITS = {
    "phantom": ["job", "fine_voxel"],
    "project": ["job", "ray_step"],
    "acquire": ["job", "ray"],
    "reconstruct_fbp": ["job", "ray", "image_voxel_view"],
    "reconstruct_sirt": ["ray_step", "ray_step_lane", "image_voxel_term"],
    "extract": ["job", "image_voxel"],
    "merge_features": ["job", "image"],
    "noise_calibration": ["job", "image_voxel"],
    "trust": ["job", "comparison"],
}
HEAD = """# What one core took, and what was written, per unit of work (units: jobs.py and diagnoses.py in
# virtual_phantom/study/costs). Made by benchmarks/fit_rates.py, of diagnoses by diagnosis_rates.py, of voxel-driven
# SIRT by sirt_rates.py. `snakemake plan` stops at a stage that is not here.
"""
RATES = RESOURCES / "rates.yaml"


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
    for work, times in measured:
        whole = sum(times.values())
        for part, took in times.items():
            rows.append([work[unit] / whole if unit in parts[part] else 0.0 for unit in units])
            shares.append(took / whole)
    return _least_squares(np.array(rows), np.array(shares), units)


def _least_squares(work: np.ndarray, target: np.ndarray, units: Sequence[str]) -> dict[str, float]:
    largest = work.max(axis=0)
    scale = np.where(largest > 0, largest, 1.0)  # avoids division by zero for units that no job has
    found, _ = nnls(work / scale, target)
    return {unit: float(rate) for unit, rate in zip(units, found / scale, strict=True) if rate > 0}


def records(folder):
    """{output: Snakemake's metadata of its job}."""
    return {
        base64.b64decode(path.name).decode(): json.loads(path.read_text(encoding="utf-8"))
        for path in (folder / ".snakemake" / "metadata").iterdir()
    }


def size(path):
    """Bytes of a file, or of all files in a folder."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def write(rates):
    """Write the library's rates with four digits."""
    rounded = json.loads(json.dumps(rates), parse_float=lambda text: float(f"{float(text):.4g}"))
    write_text(HEAD + yaml.safe_dump(rounded, sort_keys=False), RATES)


def add_arguments(parser):
    parser.add_argument("--config", type=Path, default=common.ROOT / "config" / "paper_groups.yaml")
    parser.add_argument("--folder", type=Path, default=common.ROOT, help="working directory of the study")
    parser.add_argument("--machine", required=True, help="description of the machine for rates.yaml")


def run(options):
    config = read_study(yaml.safe_load(options.config.read_text(encoding="utf-8")) | {"keep_projections": True})
    plan = Plan(config)
    results = Path(config.results_dir)
    times = {output: one["endtime"] - one["starttime"] for output, one in records(options.folder).items()}
    timed, amounts, found = [], defaultdict(float), defaultdict(float)
    for job in study_jobs(plan, "cpu", len(plan.tissue_classes)):
        files = [options.folder / results / output for output in job.outputs]
        if str(results / job.outputs[0]) in times and all(file.exists() for file in files):
            timed.append((job, times[str(results / job.outputs[0])]))
            for kind, amount in job.writes.items():
                amounts[kind] += amount
                found[kind] += sum(map(size, files))
    amounts["logs"], found["logs"] = len(timed), size(options.folder / results / "logs")
    grid, scan = config.grid, config.scan
    rates = {
        "measured": {
            "machine": options.machine,
            "jobs": len(timed),
            "voxels": list(grid.shape),
            "detector_rows_columns": [scan.rows, scan.columns],
            "projections": sorted({protocol.projections for protocol in config.protocols.values()}),
            "seconds": {stage: round(total["measured"], 1) for stage, total in by_stage(timed).items()},
            "bytes": dict(sorted(found.items())),
        },
        "seconds": fit(timed, STAGE_UNITS),
        "bytes": {kind: found[kind] / amounts[kind] for kind in sorted(amounts)},
    }
    report(timed, rates)
    before = read_rates(RATES)
    print("rates that stay as they were:", *sorted(before["seconds"].keys() - rates["seconds"].keys()))
    write({part: before[part] | rates[part] for part in rates})


def by_stage(timed, rates=None):
    """{stage: {jobs, measured, estimated}}; estimates only if rates are given."""
    totals = defaultdict(lambda: {"jobs": 0, "measured": 0.0, "estimated": 0.0})
    for job, took in timed:
        total = totals[job.stage]
        total["jobs"] += 1
        total["measured"] += took
        total["estimated"] += seconds(job, rates) if rates else 0.0
    return totals


def report(timed, rates):
    print(f"{'stage':20s} {'jobs':>5s} {'measured s':>11s} {'estimated s':>11s}")
    for stage, total in by_stage(timed, rates).items():
        print(f"{stage:20s} {total['jobs']:5d} {total['measured']:11.1f} {total['estimated']:11.1f}")
