"""Count correct diagnoses of scans that the library's own chain simulates (40 s of one core per scan).

Kinds: `single` (one effect), `none`, `pair` (two effects) and `missing` (one effect that is not a candidate). The
signal-to-noise ratio of an effect, beyond what the alignment absorbs, is 5 to 50 (log-uniform). The scan has twice as
many rays per pixel and direction as the model. Edges are blurred so that the numerical errors of the model stay small.
In the table, `left` is the part of the hidden effects that the diagnosis does not explain, without noise, in standard
deviations of the held-out data. `seen` are the domains in which it is significant. `worst` is the first unexplained
domain.
"""

import time
from collections import Counter
from itertools import pairwise

import numpy as np

from benchmarks import common
from benchmarks.common.chain_scans import (
    EDGE_MM,
    GEOMETRY,
    LIBRARY,
    PHOTONS,
    STRONGEST,
    WEAKEST,
    scans,
    scene,
    shapes_scene,
    strengths,
)
from virtual_phantom.diagnosis.fitting.linearization import Linearization, LinearizationPoint
from virtual_phantom.diagnosis.fitting.templates import whitened
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.projections.residual_maps import domain_tests
from virtual_phantom.diagnosis.residuals.residual_tests import EDGE_SHARE, HalfResiduals, alignment_tests
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain

SQUARES_SD = 3.5  # threshold for sums of squares; false-positive rate below 1e-3
LEFT_BINS = (WEAKEST, 10.0, 20.0, np.inf)
LEFT_OPEN = ("unexplained", "mismatch partly explained")
FIELDS = (
    *"draw kind truth chosen alternatives verdict seconds excess_removed left seen worst".split(),
    *"parameter value low high".split(),
)


def left_over(prepared_data, physics, fit):
    """Hidden physics that a fit does not explain, without noise: size in SDs, and domains where it is significant."""
    fitter, held_out = prepared_data.fitter, prepared_data.held_out
    place = {one.name: one.expected for one in fitter.model.base_nuisances}
    truth = fitter.model.predict(physics, place, held_out, Linearization(*2 * (LinearizationPoint.of(physics, place),)))
    gain = fitter.model.chain.state(physics).gain
    found = fitter.model.predict(fit.physics, fit.nuisance, held_out, fit.linearization)
    parts = [there - here for there, here in zip(held_out.residuals(found), held_out.residuals(truth), strict=True)]
    shape = held_out.mean.shape
    pattern = (0 if fit.pattern is None else -fit.pattern.values) - (0 if gain is None else np.log(gain))
    parts[0] = (parts[0].reshape(shape) + held_out.whitened(pattern)).ravel()
    size = float(np.linalg.norm(whitened(parts, fitter.held_weights)))
    fitted = HalfResiduals([part.copy() for part in parts], fitter.weights, prepared_data.data)
    more = alignment_tests(fit, fitter.model.distortions)
    places = domain_tests(HalfResiduals(parts, fitter.held_weights, held_out), fit.pattern_variance, fitted, more)
    # Without noise, a sum of squares lacks the expectation of the noise.
    weight = fitter.held_weights[0].reshape(shape)
    terms = {"edges": EDGE_SHARE * (weight > 0).sum(), "pixels": (weight.sum(axis=0) > 0).sum()}
    seen = [
        place.domain
        for place in places
        if (place.z + np.sqrt(terms[place.domain] / 2) > SQUARES_SD if place.domain in terms else place.significant)
    ]
    return size, seen


def diagnose_scan(task):
    kind, draw, samples, edge_mm, finer, shaped = task
    random = np.random.default_rng(np.random.SeedSequence(20261121, spawn_key=(len(kind), draw)))
    bare = shapes_scene() if shaped else scene(edge_mm)
    chain = Chain(bare, GEOMETRY, PHOTONS, samples=finer * samples)
    model, floor = model_and_floor(bare, GEOMETRY, samples, photons=PHOTONS)
    options = {"floor_chain": floor, "nominal_photons": PHOTONS}
    blank = prepared.prepare(scans(chain, {}, random), None, model, **options)
    count = {"none": 0, "pair": 2}.get(kind, 1)
    truth = [str(name) for name in random.permutation(LIBRARY)[:count]]
    if count == 1:  # each effect is hidden in turn
        truth = [LIBRARY[draw % len(LIBRARY)]]
    physics = {}
    for name in truth:
        target_snr = common.log_uniform(random, WEAKEST, STRONGEST)
        physics[name] = strengths(name, target_snr, random, blank)
    began = time.perf_counter()
    prepared_data = prepared.prepare(scans(chain, physics, random), None, model, **options)
    tried = [name for name in LIBRARY if kind != "missing" or name not in truth]
    found = choose(prepared_data.whole, trial(prepared_data.whole, ()), tried)
    content = diagnose("draw", prepared_data, found, found.on_halves(prepared_data)).content
    left, seen = left_over(prepared_data, physics, found.chosen.fit)
    row = {
        "draw": draw,
        "kind": kind,
        "truth": "+".join(truth) or "none",
        "chosen": "+".join(effect["name"] for effect in content["effects"]) or "none",
        "alternatives": ";".join("/".join(found.ambiguous_with(name)) for name in found.chosen.fit.effects),
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
        alternatives = [set(part.split("/")) for part in row["alternatives"].split(";")]
        first = {chosen[0]}
        named += bool(first & truth)
        group += bool((first | alternatives[0]) & truth)
        exact += set(chosen) == truth
    n = len(draws)
    if draws and next(iter(draws))["kind"] == "missing":
        detectable = [row for row in draws if row["left"] >= WEAKEST]
        right = [row for row in detectable if row["verdict"] in LEFT_OPEN and row["worst"] in row["seen"].split(";")]
        open_ = [row for row in detectable if row["verdict"] in LEFT_OPEN]
        print(f"{n - len(detectable)} explained by alternatives within the noise")
        print(f"of the other {len(detectable)}: {len(open_)} not or partly explained, {len(right)} in the right domain")
        for low, high in pairwise(LEFT_BINS):
            within = [row for row in detectable if low <= row["left"] < high]
            found = sum(row in right for row in within)
            print(f"  left {low:g} to {high:g}: {found} of {len(within)} in the right domain")
    verdicts = dict(Counter(row["verdict"] for row in draws))
    removed = [row["excess_removed"] or 0.0 for row in draws if row["kind"] != "none"]
    covered = [row["low"] <= row["value"] <= row["high"] for row in rows if row.get("parameter")]
    print(f"{n} draws: named first {named / n:.1%}, first or alike {group / n:.1%}, exact set {exact / n:.1%}")
    print("verdicts", verdicts)
    if removed:
        print(f"held-out excess removed: median {np.median(removed):.1%}")
    if covered:
        print(f"intervals cover {np.mean(covered):.1%} of {len(covered)}")
    print(f"seconds per draw: median {np.median([row['seconds'] for row in draws])}")


def add_arguments(parser):
    parser.add_argument("--kind", choices=("single", "none", "pair", "missing"), default="single")
    common.add_realizations(parser, 100, out="draws.csv")
    parser.add_argument("--samples", type=int, default=2, help="rays per pixel and direction of the model")
    parser.add_argument("--edge-mm", type=float, default=EDGE_MM, help="SD of the Gaussian blur of edges")
    parser.add_argument(
        "--finer", type=int, default=2, help="factor of rays per pixel and direction between scan and model"
    )
    parser.add_argument("--shapes", action="store_true", help="use an object of shapes with sharp edges")


def run(options):
    draws = range(options.first, options.first + options.draws)
    settings = options.samples, options.edge_mm, options.finer, options.shapes
    tasks = [(options.kind, draw, *settings) for draw in draws]
    rows = []
    for found in common.parallel_rows(diagnose_scan, tasks, options, FIELDS):
        rows += found
        print({key: found[0][key] for key in FIELDS[:8]}, flush=True)
    summary(rows)
