"""Measure the coverage of confidence intervals of two recordings of one scanner, jointly and separately (10 minutes).

The blind validation's simulator scans the quality-assurance phantom and the abdomen with the same three effects of
medium strength, and these are fitted. Also counts how often the consistency test rejects the two recordings, and how
often it rejects them if the first effect of the abdomen's scan has other parameters. Cases in the output file are not
repeated.
"""

import time
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import simulator_scans
from benchmarks.common.tuning_objects import OBJECTS
from benchmarks.intervals import LEVELS, coverage, shares
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.residuals.residual_tests import ALPHA
from virtual_phantom.diagnosis.scanner.consistency import alone
from virtual_phantom.diagnosis.uncertainty.model_error import influences_of_recordings, joint_errors_with_models
from virtual_phantom.physics.effect import load

EFFECTS = 3
FURTHER = 10_000  # first number of recordings with other parameters; gives them other noise
WAYS = ("both", *OBJECTS)


def drawn(number, seed):
    """Effects of a scanner, and the same with other parameters of the first effect."""
    random = generator(branch(seed, number))
    shared = [name for name in simulator_scans.declarable_effects() if not load(name).of_one_scan]
    effects = [
        simulator_scans.of_catalogue(name, "medium", random) for name in random.choice(shared, EFFECTS, replace=False)
    ]
    return effects, [simulator_scans.of_catalogue(effects[0]["name"], "medium", random), *effects[1:]]


def scanned(number, phantom, effects, config, seed):
    """Prepared recording of a phantom."""
    truth = {"case": f"case_{number:02d}", "number": number, "phantom": phantom, "effects": effects}
    return simulator_scans.prepared(truth, config, seed)[1]


def fitted(made, effects, accuracy):
    """Parameters fitted jointly, and the consistency test of each recording."""
    names = tuple(effect["name"] for effect in effects)

    def fit():
        together = JointFitter({name: one.fitter for name, one in made.items()})
        return together, together.fit(names, together.fit(()))

    together, found = fit()
    again = {name: one.with_noise_of(found.fits[name]) for name, one in made.items()}
    if any(again[name] is not one for name, one in made.items()):
        made = again
        together, found = fit()
    without = {name: together.fit(tuple(one for one in names if one != name), found) for name in names}
    scans = influences_of_recordings(together, found, without, accuracy)
    errors, first = joint_errors_with_models(scans), next(iter(made))
    rows = [
        {
            "effect": effect["name"],
            "name": key,
            "truth": truth,
            "value": found.fits[first].physics[effect["name"]][key],
            "noise": found.fits[first].errors[effect["name"]][key],
            "whole": errors[first][effect["name"]][key],
        }
        for effect in effects
        for key, truth in effect["comparable"].items()
        if key in errors[first][effect["name"]]
    ]
    differences = [one.difference for one in alone(together, found, scans).values()]
    return rows, [
        {"chi_square": difference.chi_square, "numbers": difference.numbers, "p": difference.p}
        for difference in differences
    ]


def counted(draws):
    for way, text in (("apart", "recordings of one scanner"), ("apart_other", "with another first effect in one")):
        found = sum(any(one["p"] < ALPHA for one in draw[way]) for draw in draws)
        print(f"{text}: {found} of {len(draws)} pairs are inconsistent")
    print(f"{'fitted to':12} {'n':>4}  noise 50/80/95  whole 50/80/95  width over that of both (median)")
    widths = {way: np.array([row["whole"] for draw in draws for row in draw[way]]) for way in WAYS}
    for way in WAYS:
        rows = [row for draw in draws for row in draw[way]]
        print(f"{way:12} {len(rows):4}  {shares(rows)}  {np.median(widths[way] / widths['both']):6.2f}")
    every = [row for draw in draws for row in draw["both"]]
    for effect in sorted({row["effect"] for row in every}):
        rows = [row for row in every if row["effect"] == effect]
        share = 100 * coverage(rows, "noise", "whole")[-1]
        print(f"  {effect:24} {len(rows):3}  {share:3.0f} % by {100 * LEVELS[-1]:g} % intervals")


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--out", type=Path, required=True)


def run(options):
    config = common.configuration()
    accuracy = config.diagnosis.model_accuracy
    draws = common.read_jsonl(options.out)
    done, second = {draw["number"] for draw in draws}, list(OBJECTS)[-1]
    for number in range(options.draws):
        if number in done:
            continue
        began, (effects, other_day) = time.process_time(), drawn(number, options.seed)
        made = {
            phantom: scanned(len(OBJECTS) * number + place, phantom, effects, config, options.seed)
            for place, phantom in enumerate(OBJECTS)
        }
        other = scanned(FURTHER + number, second, other_day, config, options.seed)
        one = {"number": number}
        one["both"], one["apart"] = fitted(made, effects, accuracy)
        one |= {phantom: fitted({phantom: scan}, effects, accuracy)[0] for phantom, scan in made.items()}
        _, one["apart_other"] = fitted(made | {second: other}, other_day, accuracy)
        draws.append(one)
        common.append_jsonl(options.out, one)
        text = (
            f"{row['effect']}.{row['name']} {row['value']:.4g} +- {row['whole']:.2g}, {row['truth']:.4g}"
            for row in one["both"]
        )
        print(f"{number} [{time.process_time() - began:.0f} s]: {'; '.join(text)}", flush=True)
    counted(draws)
