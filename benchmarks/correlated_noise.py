"""Measure the distribution of z in every domain and the false alarms for correlated noise (minutes).

The library's chain simulates four repeats of each scan. The true effect is fitted with the alignment, and the held-out
data are tested as in a diagnosis. With correct errors z has mean 0 and standard deviation 1. The tests were tuned on
realizations below 1000.
"""

import time
from collections import defaultdict

import numpy as np
from scipy import ndimage, stats

from benchmarks import common
from benchmarks.common import chain_scans
from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.residuals.residual_tests import alignment_tests
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.scene import VoxelScene

PHOTONS, REPEATS, EDGE_MM, INTERVAL_MS = 1e5, 4, 3.0, 1.0
GEOMETRY = common.circular_scan(72, 48, 8, 11.0, 8.0, view_interval_ms=INTERVAL_MS)


def crosstalk(share):
    return {"optical_crosstalk": {"column": share, "row": share}}


def afterglow(share, memory=0.1):
    """Afterglow of a share of the signal; each further view retains the fraction `memory`."""
    ratio = -np.log(memory)  # view interval / time constant
    of_light = share * ratio / (1 - memory)  # without the part within the same view
    return {"afterglow": {"share": of_light, "time_constant_ms": INTERVAL_MS / ratio, "before": 1.0}}


SETTINGS = {
    "nothing": {},
    "crosstalk 0.03": crosstalk(0.03),
    "crosstalk 0.05": crosstalk(0.05),
    "crosstalk 0.10": crosstalk(0.10),
    "crosstalk 0.15": crosstalk(0.15),
    "afterglow 0.05": afterglow(0.05),
    "afterglow 0.10": afterglow(0.10),
    "afterglow 0.20": afterglow(0.20),
}
FIELDS = ("setting", "draw", "verdict", "seconds", "worst", "p", "domain", "place", "z")


def scene():
    """Elliptic body with an off-axis dense and light insert; edges blurred by a Gaussian."""
    grid = Grid((32, 96, 96), (3.0, 3.0, 3.0))
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    hu = np.where((x / 110) ** 2 + (y / 80) ** 2 < 1, 20.0, -1000.0)
    hu = np.where((x - 50) ** 2 + (y - 10) ** 2 + (z - 5) ** 2 < 20**2, 800.0, hu)
    hu = np.where((x + 40) ** 2 + (y + 20) ** 2 + (z + 5) ** 2 < 18**2, -80.0, hu)
    hu = ndimage.gaussian_filter(hu, np.array(EDGE_MM) / grid.spacing, mode="nearest")
    return VoxelScene.of(Volume(hu.astype(np.float32), grid), Segmentation(), 0.0193)


def location_rows(chain, model, name, draw):
    """One row per location of the residual maps."""
    physics, key = SETTINGS[name], (list(SETTINGS).index(name), draw)
    random = np.random.default_rng(np.random.SeedSequence(23, spawn_key=key))
    began = time.perf_counter()
    taken = chain_scans.scans(chain, physics, random, repeats=REPEATS)
    prepared_data = prepared.prepare(taken, None, model, nominal_photons=PHOTONS)
    fit = trial(prepared_data.fitter, tuple(physics), trial(prepared_data.fitter, ())).fit
    correlated = prepared_data.with_noise_of(fit)
    if correlated is not prepared_data:
        prepared_data = correlated
        fit = trial(prepared_data.fitter, tuple(physics), trial(prepared_data.fitter, ())).fit
    fitted, held_out = prepared_data.halves(fit)
    places = prepared_data.domains(held_out, fit, fitted, alignment_tests(fit, prepared_data.fitter.model.distortions))
    worst = places[0]
    row = {"setting": name, "draw": draw, "seconds": round(time.perf_counter() - began, 2)}
    row |= {"verdict": "left" if worst.significant else "nothing left", "worst": worst.domain, "p": worst.p}
    rows = []
    for place in places:
        values = place.map.ravel()
        if place.domain == "pixels":
            rows.append(row | {"domain": "pixels, their sum of squares", "place": 0, "z": place.z})
        if place.domain == "both halves":  # one-sided
            values = values[values > 0]
        rows += [row | {"domain": place.domain, "place": i, "z": round(float(z), 4)} for i, z in enumerate(values)]
    return rows


def summary(rows):
    settings, domains = (list(dict.fromkeys(row[key] for row in rows)) for key in ("setting", "domain"))
    squares = defaultdict(list)
    for row in rows:
        squares[row["setting"], row["domain"]].append(row["z"])
        squares["all", row["domain"]].append(row["z"])
    print("| domain |", " | ".join([*settings, "all"]), "|")
    for domain in sorted(domains):
        cells = [np.array(squares[setting, domain]) for setting in (*settings, "all")]
        cells = [f"{np.sqrt((z**2).mean()):.3f}" if len(z) else "-" for z in (z[z != 0] for z in cells)]
        print(f"| {domain} |", " | ".join(cells), "|")
    draws = {(row["setting"], row["draw"]): row for row in rows}.values()
    left = [row for row in draws if row["verdict"] == "left"]
    for setting in settings:
        those = [row for row in left if row["setting"] == setting]
        print(setting, ": left in", len(those), "of", sum(row["setting"] == setting for row in draws), end=" ")
        print([f"{row['draw']}: {row['worst']} p {row['p']:.1e}" for row in those])
    interval = stats.binomtest(len(left), len(draws)).proportion_ci(0.95, "exact")
    print(f"something left in {len(left)} of {len(draws)}, 95 % {interval.low:.2%} to {interval.high:.2%}")
    print(f"seconds: median {np.median([row['seconds'] for row in draws])}")


def add_arguments(parser):
    common.add_realizations(parser, 40, 1000)
    parser.add_argument("--out", default="correlated_noise.csv")


def run(options):
    bare = scene()
    chain, model = Chain(bare, GEOMETRY, PHOTONS), Chain(PosedScene(bare, 1), GEOMETRY, PHOTONS)
    rows = []
    with common.csv_writer(options.out, FIELDS) as write:
        for name in SETTINGS:
            for draw in range(options.first, options.first + options.draws):
                found = location_rows(chain, model, name, draw)
                write(*found)
                rows += found
    summary(rows)
