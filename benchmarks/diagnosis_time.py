"""How long a whole diagnosis of one recording takes, on a larger scan than benchmarks/diagnosis_draws.py.

    python benchmarks/diagnosis_time.py --effect scatter --processes 2

128 columns x 16 rows x 180 views, 4 repeats of 1e5 photons per pixel, one effect at half of its typical strength left
out, made by the library's own chain: preparation, alignment, every effect on projections alone (in processes of their
own, as Snakemake runs them), and the choice among them.
"""

import argparse
import os
import time

import numpy as np
from diagnosis_draws import PHOTONS, scans, scene

from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, names

STRENGTH = 0.5
GEOMETRY = circular(
    views=180,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=128,
    rows=16,
    column_pitch_mm=4.0,
    row_pitch_mm=4.0,
    view_interval_ms=5.0,
)


def weaker(chain, name):
    """Parameters with a neutral value at STRENGTH of the way to the typical one."""
    return {
        one.name: one.typical if one.neutral is None else one.neutral + STRENGTH * (one.typical - one.neutral)
        for one in chain.parameters(name)
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effect", default="scatter")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    random = np.random.default_rng(np.random.SeedSequence(20261121))
    exact = Chain(scene(), GEOMETRY, PHOTONS, samples=options.samples + 2)
    taken = scans(exact, {options.effect: weaker(exact, options.effect)}, random)
    marks, began = {}, time.perf_counter()

    def mark(name):
        marks[name] = time.perf_counter() - began - sum(marks.values())
        print(f"{name:12s} {marks[name]:7.1f} s", flush=True)

    model, floor = model_and_floor(scene(), GEOMETRY, options.samples, photons=PHOTONS)
    given = prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=PHOTONS)
    mark("preparation")
    baseline = trial(given.fitter, ())
    mark("alignment")
    library = [name for name in names() if not acts_on_images(name)]
    found = choose(given.fitter, baseline, library, options.processes)
    mark("choice")
    content = diagnose("benchmark", given, found).content
    mark("verdict")
    print(content["sentence"])
    print(f"all {sum(marks.values()):.0f} s, {len(library)} candidates, {options.processes} processes")
    print(f"load of the machine over the last 5 minutes {os.getloadavg()[1]:.1f}, {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
