"""Whether those effects are fitted that could win: gains of first order beside gains of full fits, of all candidates.

    python benchmarks/first_order.py --seed 902 --out first_order.jsonl

The scans of benchmarks/diagnosis_draws.py, each with one effect that stands a given number of standard deviations out
of the noise, or as far as its range reaches. `choose` fits only what first order puts among the best few. Here all are
fitted, and the best on data held out is looked for among those few. Three quarters of a minute for a draw on one core;
goes on where it was stopped.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from diagnosis_draws import GEOMETRY, PHOTONS, scans, scene, strengths

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.selection.forward_selection import AS_GOOD, LEAST_GAIN, could_win
from virtual_phantom.diagnosis.selection.screening import Screened, screened
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, names

WANTED = (4000.0, 8.0, 60.0, 600.0)  # standard deviations: the strongest are the least straight
SAMPLES = 2


def drawn(name, wanted, random, given, exact):
    """One effect's row: {candidate: (gain of first order, blind, gain in log score of a full fit)}."""
    physics = {name: exact.held(name) | strengths(name, wanted, random, given)}
    model, floor = model_and_floor(scene(), GEOMETRY, SAMPLES, photons=PHOTONS)
    taken = scans(exact, physics, random)
    ready = prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=PHOTONS)
    baseline = trial(ready.fitter, ())
    library = [one for one in names() if not acts_on_images(one)]
    found = screened(ready.fitter, baseline.fit, library)
    fits = {one: trial(ready.fitter, (one,), baseline, baseline) for one in library}
    return {one: (found[one].gain, found[one].blind, fits[one].score - baseline.score, found[one].p) for one in library}


def summary(rows):
    """What the table of docs/validation/simulated-scans.md has."""
    count = lost = close = close_lost = fitted = 0
    for row in rows:
        found = {one: Screened(p, gain, blind) for one, (gain, blind, _, p) in row["candidates"].items()}
        scores = {one: score for one, (_, _, score, _) in row["candidates"].items()}
        few, best = could_win(found), max(scores, key=scores.get)
        fitted += len(few)
        if scores[best] < LEAST_GAIN:
            continue
        count += 1
        lost += best not in few
        near = [one for one in scores if scores[one] > scores[best] - AS_GOOD]
        close, close_lost = close + len(near), close_lost + sum(one not in few for one in near)
    print(f"{len(rows)} draws, {fitted / len(rows):.1f} candidates fitted of {len(rows[0]['candidates'])}")
    print(f"best of all fits not among them: {lost} of {count}; of those as good: {close_lost} of {close}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=902)
    parser.add_argument("--wanted", type=float, nargs="+", default=WANTED)
    parser.add_argument("--out", type=Path, default=Path("first_order.jsonl"))
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    there = {(row["effect"], row["wanted"]) for row in rows}
    exact = Chain(scene(), GEOMETRY, PHOTONS, samples=2 * SAMPLES)
    model, floor = model_and_floor(scene(), GEOMETRY, SAMPLES, photons=PHOTONS)
    root = np.random.SeedSequence(options.seed)
    nothing = scans(exact, {}, np.random.default_rng(root))
    given = prepared.prepare(nothing, None, model, floor_chain=floor, nominal_photons=PHOTONS)
    tasks = [(wanted, name) for wanted in options.wanted for name in names() if not acts_on_images(name)]
    for place, (wanted, name) in enumerate(tasks):
        if (name, wanted) in there:
            continue
        random = np.random.default_rng(np.random.SeedSequence([options.seed, place]))
        try:
            candidates = drawn(name, wanted, random, given, exact)
        except ValueError as error:  # stands nowhere out of this noise
            print(error)
            continue
        rows.append({"effect": name, "wanted": wanted, "candidates": candidates})
        with open(options.out, "a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(name, wanted, flush=True)
    summary(rows)


if __name__ == "__main__":
    main()
