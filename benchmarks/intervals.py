"""Measure the coverage of confidence intervals of fitted parameters, with and without model errors (5 minutes).

Each scan of the blind validation's simulator has one effect with known parameters, and that effect is fitted. Cases in
the output file are not repeated. `--count FILE...` evaluates files of earlier runs together.
"""

from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import simulator_scans
from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.uncertainty.intervals import half_width
from virtual_phantom.diagnosis.uncertainty.model_error import errors_with_models
from virtual_phantom.proof.hiding.suite import truths

EFFECTS = (
    "focal_spot xray_crosstalk optical_crosstalk afterglow electronic_noise photon_flux current_modulation heel "
    "centre_of_rotation detector_offset source_distance motion off_focal_radiation view_blur detector_saturation "
    "focal_spot_wobble detector_row_offset source_drift view_angle_error dark_signal spectrum"
).split()
LEVELS = (0.5, 0.8, 0.95)
# Standard errors (noise, total) of the intervals: noise only; total as normal; as reported.
COUNTED = (("noise", "noise"), ("whole", "whole"), ("noise", "whole"))


def fitted(truth, config, seed):
    """Fitted parameters of a case's effect with both standard errors."""
    _, prepared, _ = simulator_scans.prepared(truth, config, seed)
    (effect,) = truth["effects"]
    name = effect["name"]

    def both(fitter):
        baseline = trial(fitter, ())
        return baseline.fit, trial(fitter, (name,), baseline, baseline).fit

    baseline, fit = both(prepared.fitter)
    if (again := prepared.with_noise_of(fit)) is not prepared:
        prepared = again
        baseline, fit = both(prepared.fitter)
    accuracy = config.diagnosis.model_accuracy
    errors = errors_with_models(prepared.fitter, fit, {name: baseline}, accuracy).physics[name]
    return {
        "chi_square": fit.parts[0] / float((prepared.fitter.weights[0] > 0).sum()),
        "parameters": [
            {
                "name": key,
                "truth": effect["comparable"][key],
                "value": fit.physics[name][key],
                "noise": fit.errors[name][key],
                "whole": errors[key],
            }
            for key in effect["comparable"]
            if key in errors
        ],
    }


def coverage(rows, noise, whole):
    """Coverage per level of the intervals from these standard errors."""
    off = np.array([abs(row["value"] - row["truth"]) for row in rows])
    halves = np.array([[half_width(level, row[noise], row[whole]) for level in LEVELS] for row in rows])
    return (off[:, None] <= halves).mean(axis=0)


def shares(rows):
    """Coverage in words for all entries of COUNTED."""
    return "  ".join("/".join(f"{100 * one:3.0f}" for one in coverage(rows, *errors)) for errors in COUNTED)


def line(words, rows):
    wider = np.median([row["whole"] / row["noise"] for row in rows if row["noise"]] or [np.nan])
    print(f"{words:24} {len(rows):4}  {shares(rows)}  {wider:6.2f}")


def counted(cases):
    print(f"{'parameters of':24} {'n':>4}  noise 50/80/95  as normal  as reported  times as wide (median)")
    by_effect = {}
    for case in cases:
        by_effect.setdefault(case["effect"], []).extend(case["parameters"])
    for name, rows in sorted(by_effect.items()):
        if rows:
            line(name, rows)
    line("all", [row for rows in by_effect.values() for row in rows])


def add_arguments(parser):
    parser.add_argument("--seed", type=int)
    parser.add_argument("--effects", nargs="*", default=EFFECTS)
    parser.add_argument("--strengths", nargs="*", default=["weak", "medium", "strong"])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--count", type=Path, nargs="*", help="evaluate files of earlier runs")
    parser.add_argument("--without", nargs="*", default=[], help="effects that --count omits")


def run(options):
    if options.count:
        if missing := [str(path) for path in options.count if not path.is_file()]:
            raise InputError(f"--count: {', '.join(missing)} not found; run with --seed and --out first")
        cases = [case for path in options.count for case in common.read_jsonl(path)]
        counted([case for case in cases if case["effect"] not in options.without])
        return
    if options.seed is None or options.out is None:
        raise InputError("--seed and --out are missing; give both, or --count")
    config = common.configuration()
    drawn = {"seed": options.seed, "effects": options.effects, "strengths": options.strengths, "none": 0, "unknown": 0}
    cases = common.read_jsonl(options.out)
    done = {case["case"] for case in cases}
    for case, truth in truths(simulator_scans.proof_settings(drawn)).items():
        (effect,) = truth["effects"]
        if case in done or not effect["comparable"]:
            continue
        found = fitted(truth, config, options.seed)
        cases.append({"case": case, "effect": effect["name"], "strength": effect["strength"]} | found)
        common.append_jsonl(options.out, cases[-1])
        text = (
            "{name} {value:.4g} +- {noise:.2g} ({whole:.2g}), {truth:.4g}".format(**parameter)
            for parameter in found["parameters"]
        )
        print(f"{case} {effect['name']} ({effect['strength']}): {'; '.join(text)}", flush=True)
    counted(cases)
