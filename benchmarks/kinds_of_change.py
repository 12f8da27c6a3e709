"""What kinds of change stand out where nothing is concealed: the null of their z, by simulation.

    python benchmarks/kinds_of_change.py --maker chain --draws 200 --out kinds_chain.csv
    python benchmarks/kinds_of_change.py --maker xcist --draws 40 --out kinds_xcist.csv

`chain`: the scans of diagnosis_draws.py with four times as many rays per pixel and direction as the model has;
--edge-mm 0 makes the object's edges sharp. `xcist`: scans by the proof's simulator as lacking.py has them, of its
objects in turn. Alignment alone is fitted. A file that has draws already is gone on with.
"""

import argparse
import csv
import tempfile
from pathlib import Path

import diagnosis_draws
import lacking
import numpy as np
import yaml

from virtual_phantom.config.config import complete
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection.forward_selection import LEAST_GAIN
from virtual_phantom.diagnosis.verdict.unmodeled import changes
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.chain import Chain
from virtual_phantom.proof.conceal.objects import OBJECTS

FIELDS = ("maker", "draw", "kind", "z", "p", "gain")
FINER, SAMPLES = 4, 2
SEED = 20261123


def by_chain(edge_mm):
    """Makes a scan with nothing concealed, ready to be fitted, of the number of a draw."""
    scene = diagnosis_draws.scene(edge_mm)
    geometry, photons = diagnosis_draws.GEOMETRY, diagnosis_draws.PHOTONS
    chain = Chain(scene, geometry, photons, samples=FINER * SAMPLES)
    model, floor = model_and_floor(scene, geometry, SAMPLES, photons=photons)

    def make(draw):
        random = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(draw,)))
        taken = diagnosis_draws.scans(chain, {}, random)
        return prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=photons)

    return make


def by_xcist():
    """The same by the proof's simulator."""
    config = complete(yaml.safe_load((lacking.ROOT / "config" / "config.yaml").read_text(encoding="utf-8")))
    objects = sorted(OBJECTS)

    def make(draw):
        truth = {"case": f"draw_{draw}", "number": draw, "phantom": objects[draw % len(objects)], "effects": []}
        with tempfile.TemporaryDirectory() as folder:
            model = lacking.recorded(Path(folder), truth, config, SEED)
            return prepare_recording(DiagnosisRequest.of(model, str(Path(folder) / "image.nii.gz"), 1))[1]

    return make


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maker", choices=("chain", "xcist"), required=True)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--edge-mm", type=float, default=diagnosis_draws.EDGE_MM)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    make = by_chain(options.edge_mm) if options.maker == "chain" else by_xcist()
    numerical = defaults_of("diagnosis", "model_accuracy")["numerical"]
    rows = []
    if options.out.is_file():
        with options.out.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    else:
        options.out.write_text(",".join(FIELDS) + "\n", encoding="utf-8")
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
        with options.out.open("a", encoding="utf-8", newline="") as file:
            csv.DictWriter(file, FIELDS).writerows(found)
        rows += found
    draws = {}
    for row in rows:
        draws.setdefault(int(row["draw"]), []).append(row)
    for kind in sorted({row["kind"] for row in rows}):
        z = np.array([float(row["z"]) for row in rows if row["kind"] == kind])
        print(f"{kind}: mean {z.mean():.2f}, SD {z.std(ddof=1):.2f}, largest {z.max():.2f} of {z.size}")
    for level in (0.1, 0.01, 0.001):
        below = [min(float(row["p"]) for row in one) * len(one) < level for one in draws.values()]
        gained = [
            any(float(row["p"]) * len(one) < level and float(row["gain"]) > LEAST_GAIN for row in one)
            for one in draws.values()
        ]
        print(f"p below {level:g}: {sum(below)} of {len(draws)}; and a gain above {LEAST_GAIN:g}: {sum(gained)}")


if __name__ == "__main__":
    main()
