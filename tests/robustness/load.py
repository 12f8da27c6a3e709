"""Run a study of many small acquisitions and many recordings: time, memory, and two runs on one folder.

python tests/robustness/load.py --acquisitions 1000 --recordings 200

Exit code 0: both finish, no job uses more memory than --limit-mb, and the tables have a row for every image and ROI. A
second Snakemake on the same folder, started during the first run, stops and reports that the folder is locked.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import psutil
import yaml

ROOT = Path(__file__).resolve().parents[2]
PROTOCOLS = 10  # of at most a hundred repeats
SCAN = {
    "trajectory": "circular",
    "source_to_isocentre_mm": 500,
    "source_to_detector_mm": 1000,
    "columns": 40,
    "rows": 4,
    "column_pitch_mm": 8.0,
    "row_pitch_mm": 8.0,
    "views": 24,
    "views_per_rotation": 24,
    "start_angle_deg": 0,
    "direction": 1,
}


def overlay(acquisitions: int, recordings: Path, names: list[str]) -> dict:
    """Tiny study with PROTOCOLS protocols of few iterations, and the necessary number of repeats."""
    protocols = {f"load_{n:02d}": {"algorithm": "sirt", "projections": 40 + n} for n in range(PROTOCOLS)}
    repeats = -(-acquisitions // PROTOCOLS)
    return {
        "grid": {"shape": [24, 80, 80], "spacing_mm": [4.0, 3.75, 3.75]},
        "protocols": protocols,
        "noise": {"levels": {"many": {"A": 6.0e-6, "repeats": repeats}}},
        "reconstruction": {"sirt": {"iterations": 10, "terms": 5}},
        "recordings": {name: str(recordings / name) for name in names},
        "analyses": {"pca": {"multicentre": {"protocols": list(protocols), "noise": ["many"]}}},
    }


def write_recordings(parent: Path, count: int) -> list[str]:
    column = np.arange(SCAN["columns"]) - (SCAN["columns"] - 1) / 2
    lines = np.broadcast_to(2 * np.exp(-((column / 8) ** 2)), (SCAN["views"], SCAN["rows"], SCAN["columns"]))
    random = np.random.default_rng(np.random.SeedSequence(1))
    names = [f"bench_{number:03d}" for number in range(count)]
    for name in names:
        (parent / name).mkdir(parents=True)
        content = {"name": name, "kind": "projections", "scan": SCAN, "repeats": ["a.h5"]}
        (parent / name / "recording.yaml").write_text(yaml.safe_dump(content))
        with h5py.File(parent / name / "a.h5", "w") as file:
            file["exchange/data"] = (lines + random.normal(0, 0.01, lines.shape)).astype(np.float32)
            file["exchange/data"].attrs["log"] = True
    return names


def largest_process_mb(process: subprocess.Popen) -> float:
    """Largest resident set of the process or any of its jobs until it ends, MB."""
    largest = 0.0
    while process.poll() is None:
        for one in [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]:
            try:
                largest = max(largest, one.memory_info().rss / 1e6)
            except psutil.Error:
                pass
        time.sleep(0.5)
    return largest


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--acquisitions", type=int, default=1000)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--limit-mb", type=float, default=2000.0)
    arguments = parser.parse_args()
    parent = Path(tempfile.mkdtemp(prefix="load-"))
    results = parent / "results"
    names = write_recordings(parent / "recordings", arguments.recordings)
    base = yaml.safe_load((ROOT / "config" / "tiny.yaml").read_text())
    whole = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
    settings = overlay(arguments.acquisitions, parent / "recordings", names)
    # An overlay can only add entries; null removes those of the files below it.
    for section, keys in (("protocols", whole["protocols"]), ("analyses", whole["analyses"])):
        settings[section] = {**dict.fromkeys(keys), **settings[section]}
    settings["noise"]["levels"] = {**dict.fromkeys(whole["noise"]["levels"]), **settings["noise"]["levels"]}
    settings["analyses"]["pca"] = {**dict.fromkeys(whole["analyses"]["pca"]), **settings["analyses"]["pca"]}
    settings["grid"] = base["grid"]
    (parent / "load.yaml").write_text(yaml.safe_dump(settings))
    command = [sys.executable, "-m", "snakemake", f"{results}/features.csv", "recordings"]
    command += ["--cores", str(arguments.cores), "--configfile", str(ROOT / "config" / "tiny.yaml")]
    command += [str(parent / "load.yaml"), "--config", f"results_dir={results}"]
    print(f"in {parent}", flush=True)
    begun = time.monotonic()
    with open(parent / "first.log", "wb") as log:
        first = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)
        while not (results / "logs").exists() and first.poll() is None:
            time.sleep(0.2)
        second = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        locked = second.returncode != 0 and "cannot be locked" in second.stderr + second.stdout
        largest = largest_process_mb(first)
    print(
        f"first run: exit code {first.returncode}, {time.monotonic() - begun:.0f} s, largest process {largest:.0f} MB"
    )
    print(f"second run: exit code {second.returncode}, {'locked out' if locked else 'NOT LOCKED OUT'}")
    if first.returncode:
        return 1
    features = pd.read_csv(results / "features.csv")
    images = len(features.drop_duplicates(["protocol", "noise", "seed"]))
    listed = len(pd.read_csv(results / "recordings" / "recordings.csv"))
    print(f"{images} images, {len(features)} rows of features, {listed} recordings")
    complete = images == PROTOCOLS * -(-arguments.acquisitions // PROTOCOLS) and listed == arguments.recordings
    return int(not (complete and locked and largest <= arguments.limit_mb))


if __name__ == "__main__":
    sys.exit(main())
