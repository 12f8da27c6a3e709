"""Fit the rates of rates.yaml, by which `snakemake plan` estimates costs, to a completed study (seconds).

Times come from Snakemake's metadata, sizes from the files in the results. Run it after config/paper_groups.yaml on an
idle machine. To include noisy projections, run the study with `--config keep_projections=True` and some of these files
as targets. Rates of stages that the study does not have stay. Prints measured and estimated totals per stage.
"""

import base64
import json
from collections import defaultdict
from pathlib import Path

import yaml

from benchmarks import common
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.io.files import write_text
from virtual_phantom.study.costs.jobs import study_jobs
from virtual_phantom.study.costs.rates import fit, read_rates, seconds

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
