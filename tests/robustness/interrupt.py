"""Kill the workflow at random times, resume it each time, and compare its tables with an uninterrupted run.

python tests/robustness/interrupt.py --kills 20                 the tiny study
python tests/robustness/interrupt.py --kills 20 --target proof   six cases of the blind test, each with its diagnosis
python tests/robustness/interrupt.py --kills 3 --target projections/views150/clean.h5    one file of the study

Every kill is a SIGKILL of the whole process group: Snakemake, its jobs and their threads. Exit code 0: every table,
JSON and image is byte-identical, only hidden files are left besides, and no checksum is wrong.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from virtual_phantom.io.files import check_unchanged

ROOT = Path(__file__).resolve().parents[2]

COMPARED = {".csv", ".json", ".yaml", ".gz", ".nii", ".npy", ".h5"}
WITH_TIMES = {"logs", "timing.json"}  # text with durations


def start(folder: Path, target: str, cores: int) -> subprocess.Popen:
    targets = {"study": [], "proof": ["proof"]}.get(target, [str(folder / target)])
    command = [sys.executable, "-m", "snakemake", *targets, "--cores", str(cores), "--nolock"]
    command += ["--configfile", str(ROOT / "config" / "tiny.yaml"), "--config", f"results_dir={folder}"]
    with open(folder.parent / f"{folder.name}.log", "ab") as log:
        return subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log, start_new_session=True)


def finish(folder: Path, target: str, cores: int) -> float:
    """Run to the end and return the seconds."""
    begun = time.monotonic()
    if start(folder, target, cores).wait() != 0:
        sys.exit(f"Error: the run failed; see {folder.parent / folder.name}.log")
    return time.monotonic() - begun


def without_minutes(score: Path) -> bytes:
    """Score of the blind test without its run time."""
    content = json.loads(score.read_bytes())
    content["targets"] = [target for target in content["targets"] if target["name"] != "minutes"]
    return json.dumps(content, sort_keys=True).encode()


def tables(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): without_minutes(path) if path.name == "score.json" else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix in COMPARED and not path.name.startswith(".") and not WITH_TIMES & set(path.parts)
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--target", default="study", help="study, proof, or a file under results_dir")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--folder", type=Path, help="where to work; by default a temporary folder")
    arguments = parser.parse_args()
    random = np.random.default_rng(np.random.SeedSequence(arguments.seed))
    parent = arguments.folder or Path(tempfile.mkdtemp(prefix="interrupt-"))
    whole, broken = parent / "whole", parent / "broken"
    parent.mkdir(parents=True, exist_ok=True)
    seconds = finish(whole, arguments.target, arguments.cores)
    print(f"unbroken: {seconds:.0f} s", flush=True)
    # A resumed run has less to do: kill times lie within an equal share of the work, plus the start.
    longest = 8 + 1.2 * seconds / (arguments.kills + 1)
    for number in range(arguments.kills):
        process = start(broken, arguments.target, arguments.cores)
        moment = float(random.uniform(0.5, longest))
        try:
            code = process.wait(moment)
            print(f"{number + 1}: ended by itself with {code} before {moment:.1f} s", flush=True)
            if code != 0:
                return 1
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            partial = len([path for path in broken.rglob(".partial-*")])
            print(f"{number + 1}: killed after {moment:.1f} s, {partial} unfinished files", flush=True)
    print(f"resumed: {finish(broken, arguments.target, arguments.cores):.0f} s", flush=True)
    expected, found = tables(whole), tables(broken)
    differ = [name for name in sorted(expected | found) if expected.get(name) != found.get(name)]
    for path in broken.rglob("*"):
        check_unchanged(path)
    print(f"{len(expected)} files compared, {len(differ)} differ", *differ[:20], sep="\n")
    return int(bool(differ))


if __name__ == "__main__":
    sys.exit(main())
