"""Check that the first-order forecast selects the effects that a full fit would choose (1 hour).

Each scan of the library's chain has one effect of a given signal-to-noise ratio. `choose` only fits the effects with
the largest forecasts. Here all effects are fitted, and the best on held-out data is looked up among the selected
effects. A scan takes 45 s of one core. Scans in the output file are not repeated.
"""

from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common.chain_scans import GEOMETRY, LIBRARY, PHOTONS, prepared_with_floor, scans, scene, strengths
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.selection.forward_selection import AS_GOOD, LEAST_GAIN
from virtual_phantom.diagnosis.selection.screening import Screened, screened, worth_fitting
from virtual_phantom.physics.chain import Chain

WANTED = (4000.0, 8.0, 60.0, 600.0)  # signal-to-noise ratios; the strongest are the least linear
SAMPLES = 2


def drawn(name, target_snr, random, prepared_data, exact):
    """{candidate: (first-order gain, blind, gain of a full fit, p)} for one missing effect."""
    physics = {name: exact.fixed_parameters(name) | strengths(name, target_snr, random, prepared_data)}
    ready = prepared_with_floor(scans(exact, physics, random), scene(), GEOMETRY, SAMPLES)
    baseline = trial(ready.fitter, ())
    found = screened(ready.fitter, baseline.fit, LIBRARY)
    fits = {one: trial(ready.fitter, (one,), baseline, baseline) for one in LIBRARY}
    return {one: (found[one].gain, found[one].blind, fits[one].score - baseline.score, found[one].p) for one in LIBRARY}


def summary(rows):
    count = lost = close = close_lost = fitted = 0
    for row in rows:
        found = {one: Screened(p, gain, blind) for one, (gain, blind, _, p) in row["candidates"].items()}
        scores = {one: score for one, (_, _, score, _) in row["candidates"].items()}
        few, best = worth_fitting(found), max(scores, key=scores.get)
        fitted += len(few)
        if scores[best] < LEAST_GAIN:
            continue
        count += 1
        lost += best not in few
        near = [score for score in scores if scores[score] > scores[best] - AS_GOOD]
        close, close_lost = close + len(near), close_lost + sum(one not in few for one in near)
    print(f"{len(rows)} draws, {fitted / len(rows):.1f} candidates fitted of {len(rows[0]['candidates'])}")
    print(f"best of all fits not among them: {lost} of {count}; of those as good: {close_lost} of {close}")


def add_arguments(parser):
    parser.add_argument("--seed", type=int, default=902)
    parser.add_argument("--wanted", type=float, nargs="+", default=WANTED)
    parser.add_argument("--out", type=Path, default=Path("first_order.jsonl"))


def run(options):
    rows = common.read_jsonl(options.out)
    there = {(row["effect"], row["wanted"]) for row in rows}
    exact = Chain(scene(), GEOMETRY, PHOTONS, samples=2 * SAMPLES)
    root = np.random.SeedSequence(options.seed)
    nothing = scans(exact, {}, np.random.default_rng(root))
    prepared_data = prepared_with_floor(nothing, scene(), GEOMETRY, SAMPLES)
    tasks = [(target_snr, name) for target_snr in options.wanted for name in LIBRARY]
    for place, (target_snr, name) in enumerate(tasks):
        if (name, target_snr) in there:
            continue
        random = np.random.default_rng(np.random.SeedSequence([options.seed, place]))
        try:
            candidates = drawn(name, target_snr, random, prepared_data, exact)
        except ValueError as error:  # too weak within its range
            print(error)
            continue
        rows.append({"effect": name, "wanted": target_snr, "candidates": candidates})
        common.append_jsonl(options.out, rows[-1])
        print(name, target_snr, flush=True)
    summary(rows)
