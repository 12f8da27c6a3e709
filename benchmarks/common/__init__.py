"""Configurations, tables, times and processes for all scenarios."""

import csv
import json
import os
import resource
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.config.config import read_study
from virtual_phantom.config.read_config import PAPER_GROUPS, read_configs

ROOT = Path(__file__).resolve().parents[2]


def read_config(path=PAPER_GROUPS):
    """Content of a YAML file; relative paths start at the project's root."""
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def configuration(*overlays):
    """Complete configuration of files, by default of the paper's groups."""
    lines, merged = read_configs([ROOT / path for path in overlays or [PAPER_GROUPS]])
    if lines:
        raise InputError("; ".join(lines))
    return read_study(merged)


def circular_scan(views, columns, rows, column_pitch_mm, row_pitch_mm=None, **further):
    """Small circular scan with the distances of a clinical scanner; pixels are square unless a row pitch is given."""
    return circular(
        views=views,
        source_to_isocentre_mm=570.0,
        source_to_detector_mm=1040.0,
        columns=columns,
        rows=rows,
        column_pitch_mm=column_pitch_mm,
        row_pitch_mm=column_pitch_mm if row_pitch_mm is None else row_pitch_mm,
        **further,
    )


# Distances and detector of a GE LightSpeed VCT.
LIGHTSPEED = {
    "source_to_isocentre_mm": 541.0,
    "source_to_detector_mm": 949.075,
    "columns": 888,
    "column_pitch_mm": 1.0239,
    "row_pitch_mm": 1.0988,
    "column_offset_px": -1.25,
}


def log_uniform(random, low, high):
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def read_jsonl(path):
    """Rows of a file, or none if it does not exist."""
    return [json.loads(row) for row in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def append_jsonl(path, row):
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def read_csv_rows(path):
    """Rows of a CSV as text, or none if it does not exist."""
    return list(csv.DictReader(path.open(encoding="utf-8", newline=""))) if path.is_file() else []


def add_realizations(parser, draws, first=0, out=None):
    """Add the options for realizations; with `out`, they run in parallel and go to a CSV."""
    parser.add_argument("--draws", type=int, default=draws, help="number of realizations")
    parser.add_argument("--first", type=int, default=first, help="number of the first realization")
    if out:
        parser.add_argument("--processes", type=int, default=os.cpu_count())
        parser.add_argument("--out", default=out)


def parallel_rows(function, tasks, options, fields, append=False):
    """Rows of each task, in order, from processes; each list is written to a CSV and yielded."""
    with ProcessPoolExecutor(options.processes) as pool, csv_writer(options.out, fields, append) as write:
        for rows in pool.map(function, tasks):
            write(*rows)
            yield rows


@contextmanager
def csv_writer(path, fields, append=False):
    """Function that writes rows to a CSV and flushes them; absent fields stay empty."""
    with open(path, "a" if append else "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, fields, restval="")
        if not file.tell():
            writer.writeheader()

        def write(*rows):
            writer.writerows(rows)
            file.flush()

        yield write


def write_table(path, rows):
    """Write rows with the columns of all rows, in a folder that is made if necessary."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with csv_writer(path, list(dict.fromkeys(name for row in rows for name in row))) as write:
        write(*rows)


def print_table(path, rows):
    """Write a table and print it."""
    write_table(path, rows)
    print(f"\n{path.name}")
    for row in rows:
        shown = (f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values())
        print("  ".join(f"{name} {value}" for name, value in zip(row, shown, strict=True)), flush=True)


def cpu_seconds(action):
    began = time.process_time()
    action()
    return time.process_time() - began


def child_seconds():
    """CPU time of finished child processes, in user mode and in all."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return np.array([used.ru_utime, used.ru_utime + used.ru_stime])


def medians(actions, repeats):
    """Median CPU time in seconds of each action; the actions take turns, after one run without measurement."""
    seconds = [[] for _ in actions]
    for action in actions:
        action()
    for _ in range(repeats):
        for action, measured in zip(actions, seconds, strict=True):
            measured.append(cpu_seconds(action))
    return [float(np.median(measured)) for measured in seconds]


def run_scenario(name, *arguments, **variables):
    """Run a scenario in a new Python with these environment variables; returns the JSON of its last line."""
    command = [sys.executable, "-m", "benchmarks", "run", name, *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, env=os.environ | variables, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])
