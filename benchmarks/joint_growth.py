"""Measure CPU time and memory of a scanner diagnosis as a function of the number of recordings (5 minutes).

The recordings are discs of water of different diameters, with scatter and a dark signal, simulated by the library's
chain. These two effects and three others are candidates. Each number of recordings is diagnosed in a new Python
process.
"""

import json
import resource
import time

import numpy as np

from benchmarks import common
from benchmarks.common import chain_scans
from virtual_phantom.base.streams import Stream, generator
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.scanner.scanner import run_scanner_diagnosis
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene

COUNTS = (1, 2, 4, 8, 16, 26)
GEOMETRY = common.circular_scan(90, 96, 2, 5.0, view_interval_ms=10.0)
DIAMETERS_MM = (60.0, 140.0)
PHYSICS = {
    "scatter": {"amount": 0.05, "width_mm": 60.0},
    "dark_signal": {"level_units": 300.0, "drift_units_per_s": 0.0},
}
TRIED = ("scatter", "dark_signal", "veiling_glare", "detector_offset", "optical_crosstalk")


def recorded(count):
    random, found = generator(Stream(count)), {}
    for number, diameter in enumerate(np.linspace(*DIAMETERS_MM, count)):
        chain = Chain(DiscScene(float(diameter), "water"), GEOMETRY, chain_scans.PHOTONS)
        place = Pose(x_mm=float(random.normal(0, 0.3)), y_mm=float(random.normal(0, 0.3)))
        found[f"disc{number}"] = prepare(chain_scans.scans(chain, PHYSICS, random, place), None, chain)
    return found


def diagnose_recordings(count):
    """CPU time, memory and named effects for a number of recordings."""
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


def add_arguments(parser):
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    parser.add_argument("--one", type=int, help="measure one number of recordings in this process")


def run(options):
    if options.one:
        print(json.dumps(diagnose_recordings(options.one)))
        return
    rows = []
    for count in options.counts:
        rows.append(common.run_scenario("joint_growth", "--one", count))
        print(rows[-1], flush=True)
    several = [row for row in rows if row["recordings"] > 1]
    if len(several) > 1:
        counts, seconds = ([row[key] for row in several] for key in ("recordings", "seconds"))
        exponent = np.polyfit(np.log(counts), np.log(seconds), 1)[0]
        print(f"seconds go with the number of recordings to the power {exponent:.2f}")
