"""How often the diagnosis is right on recordings made by the library's own chain.

    python benchmarks/diagnosis_draws.py --kind single --draws 100 --out draws_single.csv

Kinds: `single` (one effect, drawn evenly from all), `none`, `pair` (two effects), `missing` (one effect, which is taken
out of the candidates). Strengths are drawn so that what the effect changes, beyond what the alignment takes up, stands
5 to 50 standard deviations above the noise (log-uniform). The scan is small, 64 columns x 8 rows x 90 views with 4
repeats, and is taken with twice as many rays per pixel and direction as the model has. The object's edges are soft, so
that the errors of the model's rays stay under what is asked of an effect; --edge-mm 0 makes them sharp, and --shapes
has the same object as shapes, in the scan as in the model, whose edges are sharp and hold no error of voxels.

--declared 7 puts seven further effects of typical strength into every scan, which are declared with errors of 5 % of
each parameter.

`left` is what the diagnosis left of the concealed effects, without noise, in standard deviations of the data held out:
under 5, no data of this noise could tell that what it names is not what was concealed. `seen` are the domains where
that stands out, `worst` the first domain that the diagnosis calls unexplained.
"""

import argparse
import copy
import csv
import math
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import ndimage
from scipy.optimize import brentq

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.fitting.linearization import BASE, Linearization, LinearizationPoint
from virtual_phantom.diagnosis.fitting.priors import declared, stated_physics
from virtual_phantom.diagnosis.fitting.templates import strength, varied, whitened
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.projections.residual_maps import locate
from virtual_phantom.diagnosis.residuals.residual_tests import EDGE_SHARE, Half, aligned
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, load, names
from virtual_phantom.physics.scenes.scene import IN_PLACE, VoxelScene
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid

PHOTONS, REPEATS = 1e5, 4
WEAKEST, STRONGEST = 5.0, 50.0
STATED = 0.05  # of a parameter: standard deviation by which a declared one is known
FAINTEST, LEAST_SHARE = 1e-3, 1e-5  # standard deviations, and of a range: as good as nothing
EDGE_MM = 2.0
SQUARES_SD = 3.5  # of sums of squares: one in some thousand passes it by chance
LEFT_BINS = (WEAKEST, 10.0, 20.0, np.inf)
LEFT_OPEN = ("unexplained", "mismatch partly explained")
INSERTS = {"bone": ((50, 10, 5), 20.0), "adipose": ((-40, -20, -5), 18.0)}  # balls: place and radius, mm
ROD = ((-10, 45, 0), 12.0)
GEOMETRY = circular(
    views=90,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=64,
    rows=8,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
    view_interval_ms=10.0,
)
FIELDS = (
    "draw kind truth chosen stand_ins verdict seconds excess_removed left seen worst parameter value low high".split()
)


def scene(edge_mm=EDGE_MM, threads=1):
    """An elliptic body with bone, fat and a dense insert, off the axis; edges blurred by a Gaussian."""
    grid = Grid((48, 192, 192), (1.5, 1.5, 1.5))  # a third of a pixel at the isocentre, as for the proof
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    hu = np.where((x / 110) ** 2 + (y / 80) ** 2 < 1, 20.0, -1000.0)
    hu = np.where((x - 50) ** 2 + (y - 10) ** 2 + (z - 5) ** 2 < 20**2, 800.0, hu)
    hu = np.where((x + 40) ** 2 + (y + 20) ** 2 + (z + 5) ** 2 < 18**2, -80.0, hu)
    hu = np.where((x + 10) ** 2 + (y - 45) ** 2 < 12**2, 300.0, hu)
    hu = ndimage.gaussian_filter(hu, np.array(edge_mm) / grid.spacing, mode="nearest")
    return VoxelScene.of(Volume(hu.astype(np.float32), grid), Segmentation(), 0.0193, threads)


def body(**changes):
    """The same body of shapes: muscle, bone, fat and a rod of PMMA; with inserts changed, {name: shape or None}."""
    inserts = {name: ellipsoid(name, at, [radius] * 3) for name, (at, radius) in INSERTS.items()} | changes
    muscle = ellipsoid("soft_tissue", (0, 0, 0), (110, 80, 1000))
    return [muscle, *(one for one in inserts.values() if one is not None), cylinder("pmma", *ROD)]


def shapes_scene():
    """The body of shapes as a scene."""
    return ShapesScene(body())


def scans(chain, physics, random, pose=IN_PLACE):
    state = chain.state(physics, pose)
    air = state.measured_air
    repeats = [-np.log(np.maximum(state.counts(random), 0.5) / (air * state.photons)) for _ in range(REPEATS)]
    white = air.mean(axis=0) * state.photons
    return observed.Scans(np.stack(repeats).astype(np.float32), white, np.ones(repeats[0].shape, bool))


def strengths(name, wanted, random, given):
    """Parameters of an effect so that what it changes stands `wanted` standard deviations out of the noise, beyond what
    the alignment takes up; or as far as its plausible range reaches."""
    effect = load(name)
    every = given.fitter.model.parameters(name)
    typical = given.fitter.model.chain.fixed_parameters(name) | {
        parameter.name: parameter.typical for parameter in every
    }
    parameters = varied(every)
    if effect.pattern:
        pixels = math.prod(given.data.mean.shape[1:])
        noise = np.sqrt(1 / given.fitter.weights[0].reshape(given.data.mean.shape).sum(axis=0)).mean()
        return typical | {"rms": float(noise * np.sqrt(wanted * np.sqrt(2 / pixels)))}
    if not parameters:
        return {
            parameter.name: float(random.uniform(low, high))
            for parameter, (low, high) in zip(effect.parameters, ((80.0, 140.0), (3.0, 12.0), (0.3, 1.2)), strict=True)
        }
    for which in random.permutation(np.array(parameters, object)):
        rest = typical | {other.name: other.neutral for other in parameters}
        most = which.high if strength(which) > which.neutral else which.low

        def beyond(logarithm, rest=rest, which=which, most=most):
            """How far that share of the range stands out over what is wanted, as logarithms: nearly a straight line."""
            value = which.neutral + np.exp(logarithm) * (most - which.neutral)
            stands = stands_out(given, {name: rest | {which.name: value}})
            return np.log(max(stands, FAINTEST) / wanted)

        reached = beyond(0.0)
        if reached >= np.log(WEAKEST / wanted):
            share = np.exp(brentq(beyond, np.log(LEAST_SHARE), 0.0, xtol=0.03)) if reached > 0 else 1.0
            return rest | {which.name: float(which.neutral + share * (most - which.neutral))}
    raise ValueError(f"{name} stands nowhere in its range {WEAKEST} standard deviations out of this noise")


def stated(physics, model, random=None):
    """What somebody states of physics who knows every parameter to STATED of its value; without `random` just that."""
    found = {}
    for name, values in physics.items():
        low_high = {one.name: (one.low, one.high) for one in model.parameters(name)}
        found[name] = {}
        for key, value in values.items():
            sd = STATED * abs(value)
            low, high = low_high.get(key, (-np.inf, np.inf))
            drawn = value if random is None else random.normal(value, sd)
            found[name][key] = {"value": float(np.clip(drawn, low, high)), "sd": sd}
    return found


def stands_out(given, physics):
    """How far physics stands out of the noise, in standard deviations: by a fit of the alignment to what the physics
    gives without noise. Changes need not be linear, and what an object's size takes up of a distance's is not."""
    fitter = given.fitter
    place = {one.name: one.expected for one in fitter.model.aligned}
    data, beside = fitter.data, stated_physics(fitter.model.declared)
    there = Linearization(*2 * (LinearizationPoint.of(beside, place),)) if beside else BASE
    there = fitter.model.predict(beside | physics, place, data, there)
    clean = copy.copy(fitter)
    clean.data = replace(
        data,
        mean=there.mean,
        variance=np.exp(there.log_variance),
        correlation=there.correlation,
        white=there.white,
    )
    return float(np.sqrt(sum(clean.fit(()).parts)))


def left_over(given, physics, fit):
    """What a fit leaves of the concealed physics, without noise: its size in standard deviations, and in which domains
    it is significant."""
    fitter, held_out = given.fitter, given.held_out
    place = {one.name: one.expected for one in fitter.model.aligned}
    truth = fitter.model.predict(physics, place, held_out, Linearization(*2 * (LinearizationPoint.of(physics, place),)))
    gain = fitter.model.chain.state(physics).gain
    found = fitter.model.predict(fit.physics, fit.nuisance, held_out, fit.linearization)
    parts = [there - here for there, here in zip(held_out.residuals(found), held_out.residuals(truth), strict=True)]
    shape = held_out.mean.shape
    pattern = (0 if fit.pattern is None else -fit.pattern) - (0 if gain is None else np.log(gain))
    parts[0] = (parts[0].reshape(shape) + held_out.whitened(np.where(held_out.usable, pattern, 0))).ravel()
    size = float(np.linalg.norm(whitened(parts, fitter.held_weights)))
    fitted = Half([part.copy() for part in parts], fitter.weights, given.data)
    more = aligned(fit, fitter.model.distortions)
    places = locate(parts, fitter.held_weights, held_out, fit.pattern_variance, fitted, more)
    # A sum of squares has its number of terms less without noise.
    weight = fitter.held_weights[0].reshape(shape)
    terms = {"edges": EDGE_SHARE * (weight > 0).sum(), "pixels": (weight.sum(axis=0) > 0).sum()}
    seen = [
        place.domain
        for place in places
        if (place.z + np.sqrt(terms[place.domain] / 2) > SQUARES_SD if place.domain in terms else place.significant)
    ]
    return size, seen


def one(task):
    kind, draw, only, accuracy, samples, edge_mm, known, finer, shaped = task
    key = (len(kind), draw, known) if known else (len(kind), draw)
    random = np.random.default_rng(np.random.SeedSequence(20261121, spawn_key=key))
    bare = shapes_scene() if shaped else scene(edge_mm)
    chain = Chain(bare, GEOMETRY, PHOTONS, samples=finer * samples)
    model, floor = model_and_floor(bare, GEOMETRY, samples, photons=PHOTONS)
    library = [name for name in names() if not acts_on_images(name) and (only is None or name in only)]
    statable = [name for name in library if not load(name).pattern]
    beside, baseline = {}, {}
    if known:
        if kind != "none":  # what is concealed comes first, so that all are concealed in turn
            statable = [name for name in statable if name != library[draw % len(library)]]
        beside = {str(name): load(str(name)).values({}) for name in random.permutation(statable)[:known]}
        baseline = stated(beside, model, random)
    options = {"floor_chain": floor, "nominal_photons": PHOTONS}
    exact = declared(stated(beside, model), "draws")
    blank = prepared.prepare(scans(chain, beside, random), None, model, declared=exact, **options)
    library = [name for name in library if name not in beside]
    count = {"none": 0, "pair": 2}.get(kind, 1)
    truth = [str(name) for name in random.permutation(library)[:count]]
    if count == 1:
        shown = [name for name in names() if not acts_on_images(name) and (only is None or name in only)]
        truth = [shown[draw % len(shown)]]
    physics = {}
    for name in truth:
        wanted = float(np.exp(random.uniform(np.log(WEAKEST), np.log(STRONGEST))))
        physics[name] = strengths(name, wanted, random, blank)
    began = time.perf_counter()
    taken = scans(chain, beside | physics, random)
    given = prepared.prepare(taken, None, model, declared=declared(baseline, "draws"), **options)
    tried = [name for name in library if kind != "missing" or name not in truth]
    baseline = trial(given.fitter, ())
    found = choose(given.fitter, baseline, tried, accuracy=accuracy)
    content = diagnose("draw", given, found).content
    left, seen = left_over(given, beside | physics, found.chosen.fit)
    row = {
        "draw": draw,
        "kind": kind,
        "truth": "+".join(truth) or "none",
        "chosen": "+".join(one["name"] for one in content["effects"]) or "none",
        "stand_ins": ";".join("/".join(found.ambiguous_with(name)) for name in found.chosen.fit.effects),
        "verdict": content["verdict"],
        "seconds": round(time.perf_counter() - began, 1),
        "excess_removed": content["excess_removed"],
        "left": round(left, 2),
        "seen": ";".join(seen),
        "worst": content["unexplained"][0]["domain"] if content["unexplained"] else "",
    }
    rows = []
    for effect in content["effects"]:
        if effect["name"] not in physics:
            continue
        for name, value in effect["parameters"].items():
            low, high = value["ci95"]
            rows.append(row | {"parameter": f"{effect['name']}.{name}", "value": physics[effect["name"]][name]})
            rows[-1] |= {"low": low, "high": high}
    return rows or [row]


def summary(rows):
    draws = {row["draw"]: row for row in rows}.values()
    named = group = exact = 0
    for row in draws:
        truth, chosen = set(row["truth"].split("+")), row["chosen"].split("+")
        stand_ins = [set(part.split("/")) for part in row["stand_ins"].split(";")]
        first = {chosen[0]}
        named += bool(first & truth)
        group += bool((first | stand_ins[0]) & truth)
        exact += set(chosen) == truth
    n = len(draws)
    if draws and next(iter(draws))["kind"] == "missing":
        told = [row for row in draws if row["left"] >= WEAKEST]
        right = [row for row in told if row["verdict"] in LEFT_OPEN and row["worst"] in row["seen"].split(";")]
        open_ = [row for row in told if row["verdict"] in LEFT_OPEN]
        print(f"{n - len(told)} stood in for within the noise")
        print(f"of the other {len(told)}: {len(open_)} not or partly explained, {len(right)} at the right place")
        for low, high in pairwise(LEFT_BINS):
            within = [row for row in told if low <= row["left"] < high]
            found = sum(row in right for row in within)
            print(f"  left {low:g} to {high:g}: {found} of {len(within)} at the right place")
    verdicts = {}
    for row in draws:
        verdicts[row["verdict"]] = verdicts.get(row["verdict"], 0) + 1
    removed = [row["excess_removed"] or 0.0 for row in draws if row["kind"] != "none"]
    covered = [row["low"] <= row["value"] <= row["high"] for row in rows if row.get("parameter")]
    print(f"{n} draws: named first {named / n:.1%}, first or its stand-ins {group / n:.1%}, exact set {exact / n:.1%}")
    print("verdicts", verdicts)
    if removed:
        print(f"held-out excess removed: median {np.median(removed):.1%}")
    if covered:
        print(f"intervals cover {np.mean(covered):.1%} of {len(covered)}")
    print(f"seconds per draw: median {np.median([row['seconds'] for row in draws])}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=("single", "none", "pair", "missing"), default="single")
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument(
        "--accuracy", type=float, help="diagnosis.model_accuracy of all effects; finite steps are exact then"
    )
    parser.add_argument("--only", nargs="+", help="these effects instead of all")
    parser.add_argument("--samples", type=int, default=2, help="rays per pixel and direction of the model")
    parser.add_argument("--edge-mm", type=float, default=EDGE_MM, help="standard deviation by which edges are blurred")
    parser.add_argument("--declared", type=int, default=0, help="further effects in every scan, typical and declared")
    parser.add_argument(
        "--finer", type=int, default=2, help="times as many rays per pixel and direction in the scan as in the model"
    )
    parser.add_argument("--shapes", action="store_true", help="the object as shapes; its edges are sharp")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--out", default="draws.csv")
    options = parser.parse_args()
    draws = range(options.first, options.first + options.draws)
    accuracy = None if options.accuracy is None else {"default": options.accuracy}
    settings = options.only, accuracy, options.samples, options.edge_mm, options.declared, options.finer, options.shapes
    tasks = [(options.kind, draw, *settings) for draw in draws]
    rows = []
    with ProcessPoolExecutor(options.processes) as pool, open(options.out, "w", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, restval="")
        writer.writeheader()
        for found in pool.map(one, tasks):
            writer.writerows(found)
            file.flush()
            rows += found
            print({key: found[0][key] for key in FIELDS[:8]}, flush=True)
    summary(rows)


if __name__ == "__main__":
    main()
