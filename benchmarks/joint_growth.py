"""Time and memory of a scanner's diagnosis against the number of its recordings.

    python benchmarks/joint_growth.py

Discs of water of as many sizes as there are recordings, with scatter and a dark signal, by the library's own chain: 90
views of 96 columns and 2 rows, 4 repeats. These effects and three others are tried. Seconds are of the processor, each
number of recordings in a process of its own; one recording is diagnosed by itself.
"""

import argparse
import json
import resource
import subprocess
import sys
import time

import diagnosis_draws as draws
import numpy as np

from virtual_phantom.base.geometry import circular
from virtual_phantom.base.streams import Stream, generator
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.scanner.scanner import run_scanner_diagnosis
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import DiscScene, Pose

COUNTS = (1, 2, 4, 8, 16, 26)
GEOMETRY = circular(
    views=90,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=96,
    rows=2,
    column_pitch_mm=5.0,
    row_pitch_mm=5.0,
    view_interval_ms=10.0,
)
DIAMETERS_MM = (60.0, 140.0)
PHYSICS = {
    "scatter": {"amount": 0.05, "width_mm": 60.0},
    "dark_signal": {"level_units": 300.0, "drift_units_per_s": 0.0},
}
TRIED = ("scatter", "dark_signal", "veiling_glare", "detector_offset", "optical_crosstalk")


def recorded(count):
    """So many recordings, made ready."""
    random, found = generator(Stream(count)), {}
    for number, diameter in enumerate(np.linspace(*DIAMETERS_MM, count)):
        chain = Chain(DiscScene(float(diameter), "water"), GEOMETRY, draws.PHOTONS)
        place = Pose(x_mm=float(random.normal(0, 0.3)), y_mm=float(random.normal(0, 0.3)))
        found[f"disc{number}"] = prepare(draws.scans(chain, PHYSICS, random, place), None, chain)
    return found


def one(count):
    """What so many recordings cost, and what is said of them."""
    prepared, accuracy = recorded(count), defaults_of("diagnosis", "model_accuracy")
    began = time.process_time()
    if count == 1:
        found = find_missing_physics("bench", *prepared.values(), list(TRIED), accuracy)
    else:
        found = run_scanner_diagnosis("bench", prepared, TRIED, accuracy)
    seconds = time.process_time() - began
    named = [effect["name"] for effect in found.content["effects"]]
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"recordings": count, "seconds": round(seconds, 1), "mebibytes": round(megabytes), "named": named}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    parser.add_argument("--one", type=int, help="of one number of recordings, in this process")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(options.one)))
        return
    rows = []
    for count in options.counts:
        run = [sys.executable, __file__, "--one", str(count)]
        rows.append(
            json.loads(subprocess.run(run, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()[-1])
        )
        print(rows[-1], flush=True)
    several = [row for row in rows if row["recordings"] > 1]
    if len(several) > 1:
        counts, seconds = ([row[key] for row in several] for key in ("recordings", "seconds"))
        exponent = np.polyfit(np.log(counts), np.log(seconds), 1)[0]
        print(f"seconds go with the number of recordings to the power {exponent:.2f}")


if __name__ == "__main__":
    main()
