"""Measure how the time of a completed study splits over its stages (seconds).

Times come from the `benchmark:` files in results/logs, or from Snakemake's metadata. All jobs of the default study have
one thread. Writes stages.csv and stages.png. The CPU time in these files is incomplete: it is sampled every 30 s.
"""

import csv
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import yaml

from benchmarks import common
from benchmarks.fit_rates import records
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.figures import style
from virtual_phantom.study.costs.jobs import study_jobs

# Displayed stage: stages of costs.jobs, in the order of the work.
SHOWN = {
    "phantom, kernels, line integrals": ("phantom", "compile_kernels", "project", "project_physics"),
    "SIRT": ("reconstruct_sirt", "reconstruct_sirt_voxel", "reconstruct_sirt_astra_cuda"),
    "FBP": ("reconstruct_fbp",),
    "features": ("extract", "merge_features"),
    "statistics, tables": ("noise_calibration", "tables", "parquet"),
    "figures": ("figures",),
}
WAITING = "no job"


@dataclass(frozen=True)
class Span:
    """A job: displayed stage, and start and duration in seconds since the first job."""

    shown: str
    begin: float
    seconds: float

    @property
    def end(self):
        return self.begin + self.seconds


def spans(folder, config):
    """Finished jobs, sorted by start."""
    noted, results = records(folder), Path(config.results_dir)
    timed = benchmarked(folder / results / "logs")
    kinds = {stage: shown for shown, stages in SHOWN.items() for stage in stages}
    found, missing = [], []
    plan = Plan(config)
    for job in study_jobs(plan, "cpu", len(plan.tissue_classes)):
        record = noted.get(str(results / job.outputs[0]))
        if record is None:
            missing.append(job.outputs[0])
            continue
        seconds = timed.get(record["log"][0] if record["log"] else None, record["endtime"] - record["starttime"])
        found.append((kinds[job.stage], record["starttime"], seconds))
    if missing:
        sys.exit(f"{folder}: no record of {len(missing)} jobs, {missing[0]} among them; run the whole study first")
    first = min(begin for _, begin, _ in found)
    return sorted((Span(shown, begin - first, seconds) for shown, begin, seconds in found), key=lambda span: span.begin)


def benchmarked(logs):
    """{path of a log: seconds} of jobs with a `benchmark:` file."""
    found = {}
    for path in logs.rglob("*.benchmark.tsv"):
        with open(path, encoding="utf-8", newline="") as file:
            (row,) = csv.DictReader(file, delimiter="\t")
        log = path.with_name(path.name.replace(".benchmark.tsv", ".log"))
        found[str(log.relative_to(logs.parents[1]))] = float(row["s"])
    return found


def slots(jobs):
    """Assign each job to the first free slot; a job may start 0.1 s before another one ends."""
    free, chosen = [], []
    for job in jobs:
        at = next((number for number, end in enumerate(free) if end <= job.begin + 0.1), len(free))
        free[at : at + 1] = [job.end]
        chosen.append(at)
    return chosen


def table(jobs, cores):
    """Rows per displayed stage with jobs, total, longest job and share of the cores' time; waiting is last."""
    wall = max(job.end for job in jobs)
    groups = defaultdict(list)
    for job in jobs:
        groups[job.shown].append(job.seconds)
    rows = [
        {"stage": shown, "jobs": len(groups[shown]), "core_s": sum(groups[shown]), "longest_s": max(groups[shown])}
        for shown in SHOWN
        if shown in groups
    ]
    busy = sum(row["core_s"] for row in rows)
    rows.append({"stage": WAITING, "jobs": "", "core_s": cores * wall - busy, "longest_s": ""})
    for row in rows:
        row["percent"] = 100 * row["core_s"] / (cores * wall)
    return rows


@style.styled(grid=True)
def draw(jobs, rows):
    colours = style.assign(SHOWN, style.ON_WHITE) | {WAITING: "#DDDDDD"}
    figure = style.figure(style.DOUBLE_COLUMN_MM, 62)
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    names = [row["stage"] for row in rows]
    bars = left.barh(names, [row["core_s"] for row in rows], color=[colours[name] for name in names])
    left.bar_label(bars, [f"{row['core_s']:.0f} s, {row['percent']:.1f} %" for row in rows], padding=2)
    left.invert_yaxis()
    left.margins(x=0.45)
    left.set(xlabel="time of all cores (s)")
    left.grid(visible=False, axis="y")
    for job, slot in zip(jobs, slots(jobs), strict=True):
        right.broken_barh([(job.begin, job.seconds)], (slot + 0.6, 0.8), color=colours[job.shown], linewidth=0)
    count = max(slots(jobs)) + 1
    right.set(xlabel="since the first job began (s)", yticks=range(1, count + 1), ylim=(count + 0.6, 0.4))
    right.set_yticklabels([f"slot {number}" for number in range(1, count + 1)])
    right.grid(visible=False, axis="y")
    for index, axes in enumerate((left, right)):
        style.letter_panel(axes, index)
    return figure


def add_arguments(parser):
    parser.add_argument("--config", type=Path, default=common.ROOT / "config" / "paper_groups.yaml")
    parser.add_argument("--folder", type=Path, default=common.ROOT, help="working directory of the study")
    parser.add_argument("--cores", type=int, default=2, help="cores of the study")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))


def run(options):
    jobs = spans(options.folder, read_study(yaml.safe_load(options.config.read_text(encoding="utf-8"))))
    rows = table(jobs, options.cores)
    common.write_table(options.out / "stages.csv", rows)
    style.save(draw(jobs, rows), [options.out / "stages.png"])
    print(f"{len(jobs)} jobs in {max(job.end for job in jobs):.0f} s on {options.cores} cores")
    for row in rows:
        longest = f"{row['longest_s']:8.1f}" if row["longest_s"] else ""
        print(f"{row['stage']:34s}{row['jobs']:>5}{row['core_s']:9.1f} s{row['percent']:7.1f} %{longest}")
