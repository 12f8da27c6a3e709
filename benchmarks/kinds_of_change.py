"""Simulate the null distribution of z for kinds of change, without a hidden effect (10 minutes).

`--maker chain` takes scans of the library's chain with four times as many rays per pixel and direction as the model.
`--maker xcist` takes scans of the blind validation's simulator. Only the alignment is fitted. Scans in the output file
are not repeated.
"""

from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import chain_scans, simulator_scans
from benchmarks.common.tuning_objects import OBJECTS
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.selection.forward_selection import LEAST_GAIN
from virtual_phantom.diagnosis.verdict.unmodeled import changes
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.chain import Chain

FIELDS = ("maker", "draw", "kind", "z", "p", "gain")
FINER, SAMPLES = 4, 2
SEED = 20261123


def by_chain(edge_mm):
    """Function that simulates and prepares the scan of a realization without a hidden effect."""
    scene = chain_scans.scene(edge_mm)
    geometry, photons = chain_scans.GEOMETRY, chain_scans.PHOTONS
    chain = Chain(scene, geometry, photons, samples=FINER * SAMPLES)

    def make(draw):
        random = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(draw,)))
        taken = chain_scans.scans(chain, {}, random)
        return chain_scans.prepared_with_floor(taken, scene, geometry, SAMPLES)

    return make


def by_xcist():
    """As by_chain, by the simulator of the blind validation."""
    config = common.configuration()
    objects = sorted(OBJECTS)

    def make(draw):
        truth = {"case": f"draw_{draw}", "number": draw, "phantom": objects[draw % len(objects)], "effects": []}
        return simulator_scans.prepared(truth, config, SEED)[1]

    return make


def add_arguments(parser):
    parser.add_argument("--maker", choices=("chain", "xcist"), required=True)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--edge-mm", type=float, default=chain_scans.EDGE_MM)
    parser.add_argument("--out", type=Path, required=True)


def run(options):
    make = by_chain(options.edge_mm) if options.maker == "chain" else by_xcist()
    numerical = defaults_of("diagnosis", "model_accuracy")["numerical"]
    rows = common.read_csv_rows(options.out)
    done = {int(row["draw"]) for row in rows}
    for draw in range(options.draws):
        if draw in done:
            continue
        one = make(draw)
        fit = trial(one.fitter, ()).fit
        found = [
            {"maker": options.maker, "draw": draw, "kind": change.words}
            | {key: f"{getattr(change, key):.6g}" for key in FIELDS[3:]}
            for change in changes(one, fit, numerical)
        ]
        with common.csv_writer(options.out, FIELDS, append=True) as write:
            write(*found)
        rows += found
    draws = {}
    for row in rows:
        draws.setdefault(int(row["draw"]), []).append(row)
    for kind in sorted({row["kind"] for row in rows}):
        z = np.array([float(row["z"]) for row in rows if row["kind"] == kind])
        print(f"{kind}: mean {z.mean():.2f}, SD {z.std(ddof=1):.2f}, largest {z.max():.2f} of {z.size}")
    for level in (0.1, 0.01, 0.001):
        below = [min(float(row["p"]) for row in draw) * len(draw) < level for draw in draws.values()]
        gained = [
            any(float(row["p"]) * len(draw) < level and float(row["gain"]) > LEAST_GAIN for row in draw)
            for draw in draws.values()
        ]
        print(f"p below {level:g}: {sum(below)} of {len(draws)}; and a gain above {LEAST_GAIN:g}: {sum(gained)}")
