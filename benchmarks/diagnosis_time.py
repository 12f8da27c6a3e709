"""Measure the wall time of a diagnosis of 128 x 16 pixels and 180 views (2 minutes).

The scan has 4 repeats of 1e5 photons per pixel and one missing effect at half of its typical strength. The time is
measured for the preparation, the alignment, the choice among all effects and the verdict.
"""

import os
import time

import numpy as np

from benchmarks import common
from benchmarks.common.chain_scans import LIBRARY, PHOTONS, prepared_with_floor, scaled, scans, scene
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain

STRENGTH = 0.5
GEOMETRY = common.circular_scan(180, 128, 16, 4.0, view_interval_ms=5.0)


def add_arguments(parser):
    parser.add_argument("--effect", default="scatter")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--processes", type=int, default=os.cpu_count())


def run(options):
    random = np.random.default_rng(np.random.SeedSequence(20261121))
    exact = Chain(scene(), GEOMETRY, PHOTONS, samples=options.samples + 2)
    taken = scans(exact, {options.effect: scaled(exact, options.effect, STRENGTH)}, random)
    marks, began = {}, time.perf_counter()

    def mark(name):
        marks[name] = time.perf_counter() - began - sum(marks.values())
        print(f"{name:12s} {marks[name]:7.1f} s", flush=True)

    prepared_data = prepared_with_floor(taken, scene(), GEOMETRY, options.samples)
    mark("preparation")
    baseline = trial(prepared_data.whole, ())
    mark("alignment")
    found = choose(prepared_data.whole, baseline, LIBRARY, options.processes)
    mark("choice")
    content = diagnose("benchmark", prepared_data, found, found.on_halves(prepared_data)).content
    mark("verdict")
    print(content["sentence"])
    print(f"all {sum(marks.values()):.0f} s, {len(LIBRARY)} candidates, {options.processes} processes")
    print(f"load of the machine over the last 5 minutes {os.getloadavg()[1]:.1f}, {os.cpu_count()} cores")
