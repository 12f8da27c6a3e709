"""Write the verdicts of three simple methods on a suite of the blind validation (a minute per case).

`snakemake hide` makes the suite, `snakemake score --config verdicts=OUT/METHOD` the score. The methods use all repeats:

* `filter`: the effect with the largest matched filter, penalized by BIC, if its p-value over all effects is below 1 %.
* `forward`: forward selection by BIC; each step fits the five effects with the largest matched filters.
* `all`: linear least squares with the templates of all effects, then backward elimination by BIC.

`all` omits the gain pattern (one parameter per pixel). A method reports unexplained data if its chi-square is three
standard deviations too large. Existing verdicts are not repeated.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.templates import data_changes, projected, templates, whitened, with_priors
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection.screening import amounts, explained, screened
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.io.documents import VERDICT, write_document
from virtual_phantom.physics.effect import load

CHANCE = 0.01
MOST = 4  # steps of the forward selection, as in the diagnosis
FITTED = 5  # fits per step, with the largest matched filters
TOO_MANY = ("gain_pattern",)  # omitted by `all`


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
    problem, parts = Problem.at(fitter, aligned), fitter.residuals(aligned, held_out=False)
    absorbed = np.linalg.qr(with_priors(data_changes(problem), problem))[0]
    known = np.sqrt(problem.prior_precision) * (problem.center - problem.start)
    residual = np.concatenate([whitened(parts, fitter.weights), known])
    residual -= absorbed @ (absorbed.T @ residual)
    kept = [name for name in tried if name not in TOO_MANY]
    rows = {name: projected(templates(fitter, aligned, name), absorbed) for name in kept}
    # The part of the residual that templates can explain has as many numbers as there are templates.
    basis = np.linalg.qr(np.concatenate(list(rows.values())).T)[0]
    rows, inside = {name: row @ basis for name, row in rows.items()}, residual @ basis
    ends = {name: np.stack(amounts(fitter.model.parameters(name))) for name in kept}

    def criterion(names):
        if not names:
            return 0.0
        own, bounds = np.concatenate([rows[name] for name in names]), np.hstack([ends[name] for name in names])
        return price * len(own) - explained(own, inside, *bounds)

    while kept:
        without = {name: criterion([other for other in kept if other != name]) for name in kept}
        least = min(kept, key=without.get)
        if without[least] > criterion(kept):
            break
        kept.remove(least)
    gain = price * sum(len(rows[name]) for name in kept) - criterion(kept)
    rest = replace(aligned, chi_square=aligned.chi_square - gain)
    return sorted(kept, key=lambda name: -without[name]), left(fitter, rest)


METHODS = {"filter": matched_filter, "forward": forward, "all": all_at_once}


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
                fitter = prepare_recording(request)[1].whole
                for name, path in missing.items():
                    named, unexplained = METHODS[name](fitter, given["effects"])
                    verdict = {"case": case, "effects": [[effect] for effect in named], "unexplained": unexplained}
                    write_document(verdict, path, VERDICT)
                    print(case, name, named, "with unexplained differences" if unexplained else "", flush=True)
