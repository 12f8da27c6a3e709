"""How often intervals of fitted parameters hold the truth: of noise alone, and with inexact models counted.

    python benchmarks/intervals.py --seed 73 --out intervals.jsonl

Scans by the proof's simulator as lacking.py has them, each with one effect of known numbers. The right effect is
fitted, nothing is chosen. Cases that the file has already are not done again. Several files can be counted together:

    python benchmarks/intervals.py --count intervals.jsonl more.jsonl
"""

import argparse
import tempfile
from pathlib import Path

import lacking
import numpy as np

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.uncertainty.intervals import half_width
from virtual_phantom.diagnosis.uncertainty.model_error import errors_with_models
from virtual_phantom.proof.hiding.suite import truths

EFFECTS = (
    "focal_spot xray_crosstalk optical_crosstalk afterglow electronic_noise photon_flux current_modulation heel "
    "centre_of_rotation detector_offset source_distance motion off_focal_radiation view_blur detector_saturation "
    "focal_spot_wobble detector_row_offset source_drift view_angle_error dark_signal spectrum"
).split()
LEVELS = (0.5, 0.8, 0.95)
# What is counted, of noise and in all: for noise alone; with inexact models, all errors taken for normal; and as told.
COUNTED = (("noise", "noise"), ("whole", "whole"), ("noise", "whole"))


def fitted(folder, truth, config, seed):
    """The parameters of a case's effect, fitted: its numbers, and both standard errors."""
    model = lacking.recorded(folder, truth, config, seed)
    _, prepared = prepare_recording(DiagnosisRequest.of(model, str(folder / "image.nii.gz"), 1))
    (effect,) = truth["effects"]
    name = effect["name"]

    def both(fitter):
        baseline = trial(fitter, ())
        return baseline.fit, trial(fitter, (name,), baseline, baseline).fit

    baseline, fit = both(prepared.fitter)
    if (again := prepared.with_noise_of(fit)) is not prepared:
        prepared = again
        baseline, fit = both(prepared.fitter)
    accuracy = config["diagnosis"]["model_accuracy"]
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


def held(rows, noise, whole):
    """Shares of parameters that intervals of every level hold, where such standard errors are counted."""
    off = np.array([abs(row["value"] - row["truth"]) for row in rows])
    halves = np.array([[half_width(level, row[noise], row[whole]) for level in LEVELS] for row in rows])
    return (off[:, None] <= halves).mean(axis=0)


def shares(rows):
    """What intervals of every level hold, in words, as COUNTED has them."""
    return "  ".join("/".join(f"{100 * one:3.0f}" for one in held(rows, *errors)) for errors in COUNTED)


def line(words, rows):
    wider = np.median([row["whole"] / row["noise"] for row in rows if row["noise"]] or [np.nan])
    print(f"{words:24} {len(rows):4}  {shares(rows)}  {wider:6.2f}")


def counted(cases):
    print(f"{'parameters of':24} {'n':>4}  noise 50/80/95  as normal  as told  times as wide (median)")
    by_effect = {}
    for case in cases:
        by_effect.setdefault(case["effect"], []).extend(case["parameters"])
    for name, rows in sorted(by_effect.items()):
        if rows:
            line(name, rows)
    line("all", [row for rows in by_effect.values() for row in rows])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--effects", nargs="*", default=EFFECTS)
    parser.add_argument("--strengths", nargs="*", default=["weak", "medium", "strong"])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--count", type=Path, nargs="*", help="files of earlier runs: nothing is scanned")
    parser.add_argument("--without", nargs="*", default=[], help="effects that --count leaves out")
    options = parser.parse_args()
    if options.count:
        if missing := [str(path) for path in options.count if not path.is_file()]:
            parser.error(f"--count: there is no {', '.join(missing)}")
        cases = [case for path in options.count for case in lacking.rows_of(path)]
        counted([case for case in cases if case["effect"] not in options.without])
        return
    if options.seed is None or options.out is None:
        parser.error("give --seed and --out, or --count")
    config = lacking.default_config()
    drawn = {"seed": options.seed, "effects": options.effects, "strengths": options.strengths, "none": 0, "unknown": 0}
    cases = lacking.rows_of(options.out)
    done = {case["case"] for case in cases}
    for case, truth in truths(lacking.asked_of_proof(drawn)).items():
        (effect,) = truth["effects"]
        if case in done or not effect["comparable"]:
            continue
        with tempfile.TemporaryDirectory() as folder:
            found = fitted(Path(folder), truth, config, options.seed)
        cases.append({"case": case, "effect": effect["name"], "strength": effect["strength"]} | found)
        lacking.append(options.out, cases[-1])
        said = (
            f"{one['name']} {one['value']:.4g} +- {one['noise']:.2g} ({one['whole']:.2g}), {one['truth']:.4g}"
            for one in found["parameters"]
        )
        print(f"{case} {effect['name']} ({effect['strength']}): {'; '.join(said)}", flush=True)
    counted(cases)


if __name__ == "__main__":
    main()
