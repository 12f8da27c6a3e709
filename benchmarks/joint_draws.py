"""How often intervals of a scanner's parameters hold the truth: of two recordings together, and of either alone.

    python benchmarks/joint_draws.py --seed 100 --draws 20 --out joint.jsonl

Scans by the proof's simulator as lacking.py has them: of every draw one of the quality-assurance phantom and one of the
abdomen, with three effects of medium strength whose every number is known, none of one scan alone. The right effects
are fitted, nothing is chosen. Draws that the file has already are not done again.

Whether the two recordings are said to disagree is told, too; and again with another abdomen, for whose scan the first
effect has been drawn anew, as on another day.
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
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.residuals.residual_tests import ALPHA
from virtual_phantom.diagnosis.scanner.consistency import alone
from virtual_phantom.diagnosis.uncertainty.model_error import errors_of_pulled, pulled_of_recordings
from virtual_phantom.physics.effect import load
from virtual_phantom.proof.hiding.objects import OBJECTS

EFFECTS = 3
FURTHER = 10_000  # number of the first recording of another day: no other one has its noise
WAYS = ("both", *OBJECTS)


def drawn(number, seed):
    """Effects of a scanner, as a case of the proof has them, and of another day."""
    random = generator(branch(seed, number))
    shared = [name for name in statable() if not load(name).of_one_scan]
    effects = [of_catalogue(name, "medium", random) for name in random.choice(shared, EFFECTS, replace=False)]
    return effects, [of_catalogue(effects[0]["name"], "medium", random), *effects[1:]]


def scanned(folder, number, phantom, effects, config, seed):
    """A recording, made ready."""
    inside = folder / f"{number}_{phantom}"
    inside.mkdir()
    truth = {"case": f"case_{number:02d}", "number": number, "phantom": phantom, "effects": effects}
    model = lacking.recorded(inside, truth, config, seed)
    return prepare_recording(DiagnosisRequest.of(model, str(inside / "image.nii.gz"), 1))[1]


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
    scans = pulled_of_recordings(together, found, without, accuracy)
    errors, first = errors_of_pulled(scans), next(iter(made))
    rows = [
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
    apart = [one.difference for one in alone(together, found, scans).values()]
    return rows, [{"chi_square": one.chi_square, "numbers": one.numbers, "p": one.p} for one in apart]


def counted(draws):
    for way, said in (("apart", "recordings of one scanner"), ("apart_other", "with one effect drawn anew in one")):
        found = sum(any(one["p"] < ALPHA for one in draw[way]) for draw in draws)
        print(f"{said}: {found} of {len(draws)} pairs are said to disagree")
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
    done, second = {draw["number"] for draw in draws}, list(OBJECTS)[-1]
    for number in range(options.draws):
        if number in done:
            continue
        began, (effects, other_day) = time.process_time(), drawn(number, options.seed)
        with tempfile.TemporaryDirectory() as folder:
            made = {
                phantom: scanned(Path(folder), len(OBJECTS) * number + place, phantom, effects, config, options.seed)
                for place, phantom in enumerate(OBJECTS)
            }
            other = scanned(Path(folder), FURTHER + number, second, other_day, config, options.seed)
            one = {"number": number}
            one["both"], one["apart"] = fitted(made, effects, accuracy)
            one |= {phantom: fitted({phantom: scan}, effects, accuracy)[0] for phantom, scan in made.items()}
            _, one["apart_other"] = fitted(made | {second: other}, other_day, accuracy)
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
