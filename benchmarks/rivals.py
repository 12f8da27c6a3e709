"""Write the verdicts of three simple methods on a suite of the blind validation (minutes per case).

`snakemake hide` makes the suite, `snakemake score --config verdicts=OUT/METHOD` the score. The methods use all repeats:

* `filter`: the effect with the largest matched filter, penalized by BIC, if its p-value over all effects is below 1 %.
* `forward`: forward selection by BIC; each step fits the five effects with the largest matched filters.
* `all`: a fit of all effects at once; effects whose removal would increase the BIC.

`all` omits the gain pattern (one parameter per pixel) and the rotation during a view (several rays per view). A method
reports unexplained data if its chi-square is three standard deviations too large. Existing verdicts are not repeated.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.fitting.fit import Fitter
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection.screening import screened
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.io.documents import VERDICT, write_document
from virtual_phantom.physics.effect import load

CHANCE = 0.01
MOST = 4  # steps of the forward selection, as in the diagnosis
FITTED = 5  # fits per step, with the largest matched filters
TOO_MANY = ("gain_pattern", "view_blur")  # omitted by `all`


def without_halves(prepared):
    """Fitter of all repeats, weighted by noise only."""
    one, two = prepared.data, prepared.held_out
    data = replace(
        one,
        mean=(one.mean + two.mean) / 2,
        n=one.n + two.n,
        variance=(one.variance + two.variance) / 2,
        variance_error=one.variance_error / np.sqrt(2),
        correlation=(one.correlation + two.correlation) / 2,
        correlation_error=one.correlation_error / np.sqrt(2),
    )
    return Fitter(prepared.fitter.model, data, data, prepared.variance, np.zeros(data.mean.shape))


def left(fitter, fit):
    """Whether chi-square is three standard deviations too large."""
    count = sum(int((weight > 0).sum()) for weight in fitter.weights)
    return bool(fit.chi_square - count > 3 * np.sqrt(2 * count))


def priced(fitter):
    """BIC penalty ln(n) per parameter, and the parameters of an effect's pattern (one per pixel)."""
    pixels = fitter.data.mean[0].size
    return np.log(sum(int((weight > 0).sum()) for weight in fitter.weights)), lambda name: pixels * load(name).pattern


def matched_filter(fitter, tried):
    price, further = priced(fitter)
    aligned = fitter.fit(())
    found = screened(fitter, aligned, tried)
    numbers = {name: len(load(name).parameters) + further(name) for name in tried}
    best = max(found, key=lambda name: found[name].gain - price * numbers[name])
    if found[best].p * len(tried) >= CHANCE:
        return [], left(fitter, aligned)
    return [best], left(fitter, fitter.fit((best,)))


def forward(fitter, tried):
    price, further = priced(fitter)

    def criterion(fit):
        return fit.chi_square + price * (fit.free + sum(map(further, fit.effects)))

    current = fitter.fit(())
    while len(current.effects) < MOST:
        found = screened(fitter, current, [name for name in tried if name not in current.effects])
        nearest = sorted(found, key=lambda name: -found[name].gain)[:FITTED]
        fits = [fitter.fit((*current.effects, name), current) for name in nearest]
        best = min(fits, key=criterion)
        if criterion(best) >= criterion(current):
            break
        current = best
    return list(current.effects), left(fitter, current)


def all_at_once(fitter, tried):
    price, _ = priced(fitter)
    aligned = fitter.fit(())
    alone = {name: fitter.fit((name,), aligned).physics[name] for name in tried}  # all combinations: millions
    fit = fitter.fit(tuple(tried), replace(aligned, physics=alone), from_farther=False)
    worth = {}
    for name in tried:
        pulls = [
            ((fit.physics[name][parameter.name] - parameter.neutral) / fit.errors[name][parameter.name]) ** 2
            for parameter in fitter.model.parameters(name)
            if parameter.neutral is not None and fit.errors[name].get(parameter.name)
        ]
        if pulls:
            worth[name] = sum(pulls) - price * len(pulls)
    named = sorted((name for name, one in worth.items() if one > 0), key=lambda name: -worth[name])
    return named, left(fitter, fit)


def smooth_effects_at_once(fitter, tried):
    return all_at_once(fitter, [name for name in tried if name not in TOO_MANY])


METHODS = {"filter": matched_filter, "forward": forward, "all": smooth_effects_at_once}


def add_arguments(parser):
    parser.add_argument("--suite", type=Path, required=True, help="suite.json of `snakemake hide`")
    parser.add_argument("--out", type=Path, required=True, help="folder of the verdicts, one folder per method")
    parser.add_argument("--methods", nargs="*", choices=METHODS, default=list(METHODS))


def run(options):
    for case, given in json.loads(options.suite.read_text(encoding="utf-8"))["cases"].items():
        paths = {name: options.out / name / f"{case}.json" for name in options.methods}
        if missing := {name: path for name, path in paths.items() if not path.exists()}:
            request = DiagnosisRequest.of(from_mapping(FitSettings, given["model"]), given["object"].get("phantom"), 1)
            with np.errstate(divide="ignore"):  # data without variance have no weight
                fitter = without_halves(prepare_recording(request)[1])
                for name, path in missing.items():
                    named, unexplained = METHODS[name](fitter, given["effects"])
                    verdict = {"case": case, "effects": [[effect] for effect in named], "unexplained": unexplained}
                    write_document(verdict, path, VERDICT)
                    print(case, name, named, "with unexplained differences" if unexplained else "", flush=True)
