"""How often intervals of a scanner's parameters hold the truth: of two recordings together, and of either alone.

    python benchmarks/joint_draws.py --seed 96 --draws 20 --out joint.jsonl

Scans by the proof's simulator as lacking.py has them: of every draw one of the quality-assurance phantom and one of the
abdomen, with three effects of medium strength whose every number is known, none of one scan alone. The right effects
are fitted, nothing is chosen. Draws that the file has already are not done again.
"""

import argparse
import tempfile
import time
from pathlib import Path

import lacking
import numpy as np
from declared import of_catalogue, statable
from intervals import LEVELS, held, shares

from virtual_phantom.base.streams import branch, generator
from virtual_phantom.diagnosis.candidates import OF_ONE_SCAN
from virtual_phantom.diagnosis.core.asked import Asked
from virtual_phantom.diagnosis.core.inexact import errors_of_recordings
from virtual_phantom.diagnosis.core.joint import JointFitter
from virtual_phantom.diagnosis.ready import ready
from virtual_phantom.proof.conceal.objects import OBJECTS

EFFECTS = 3
WAYS = ("both", *OBJECTS)


def drawn(number, seed):
    """Effects of a scanner, as a case of the proof has them."""
    random = generator(branch(seed, number))
    shared = [name for name in statable() if name not in OF_ONE_SCAN]
    return [of_catalogue(name, "medium", random) for name in random.choice(shared, EFFECTS, replace=False)]


def scanned(folder, number, effects, config, seed):
    """Both recordings, made ready."""
    made = {}
    for place, phantom in enumerate(OBJECTS):
        inside = folder / phantom
        inside.mkdir()
        case = {"case": f"case_{number:02d}", "number": len(OBJECTS) * number + place}  # noise of its own
        truth = case | {"phantom": phantom, "effects": effects}
        model = lacking.recorded(inside, truth, config, seed)
        made[phantom] = ready(Asked.of(model, str(inside / "image.nii.gz"), 1))[1]
    return made


def fitted(made, effects, accuracy):
    """Numbers of the effects, fitted to these recordings together: value, truth and both standard errors."""
    names = tuple(one["name"] for one in effects)

    def fit():
        together = JointFitter({name: one.fitter for name, one in made.items()})
        return together, together.fit(names, together.fit(()))

    together, found = fit()
    again = {name: one.with_noise_of(found.fits[name]) for name, one in made.items()}
    if any(again[name] is not one for name, one in made.items()):
        made = again
        together, found = fit()
    without = {name: together.fit(tuple(one for one in names if one != name), found) for name in names}
    errors = errors_of_recordings(together, found, without, accuracy)
    first = next(iter(made))
    return [
        {
            "effect": one["name"],
            "name": key,
            "truth": truth,
            "value": found.fits[first].physics[one["name"]][key],
            "noise": found.fits[first].errors[one["name"]][key],
            "whole": errors[first][one["name"]][key],
        }
        for one in effects
        for key, truth in one["comparable"].items()
        if key in errors[first][one["name"]]
    ]


def counted(draws):
    print(f"{'fitted to':12} {'n':>4}  noise 50/80/95  whole 50/80/95  width over that of both (median)")
    widths = {way: np.array([row["whole"] for draw in draws for row in draw[way]]) for way in WAYS}
    for way in WAYS:
        rows = [row for draw in draws for row in draw[way]]
        print(f"{way:12} {len(rows):4}  {shares(rows)}  {np.median(widths[way] / widths['both']):6.2f}")
    every = [row for draw in draws for row in draw["both"]]
    for effect in sorted({row["effect"] for row in every}):
        rows = [row for row in every if row["effect"] == effect]
        share = 100 * held(rows, "whole")[-1]
        print(f"  {effect:24} {len(rows):3}  {share:3.0f} % by {100 * LEVELS[-1]:g} % intervals")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    config = lacking.default_config()
    accuracy = config["diagnosis"]["model_accuracy"]
    draws = lacking.rows_of(options.out)
    done = {draw["number"] for draw in draws}
    for number in range(options.draws):
        if number in done:
            continue
        began, effects = time.process_time(), drawn(number, options.seed)
        with tempfile.TemporaryDirectory() as folder:
            made = scanned(Path(folder), number, effects, config, options.seed)
            one = {"number": number, "both": fitted(made, effects, accuracy)}
            one |= {phantom: fitted({phantom: recording}, effects, accuracy) for phantom, recording in made.items()}
        draws.append(one)
        lacking.append(options.out, one)
        said = (
            f"{row['effect']}.{row['name']} {row['value']:.4g} +- {row['whole']:.2g}, {row['truth']:.4g}"
            for row in one["both"]
        )
        print(f"{number} [{time.process_time() - began:.0f} s]: {'; '.join(said)}", flush=True)
    counted(draws)


if __name__ == "__main__":
    main()
