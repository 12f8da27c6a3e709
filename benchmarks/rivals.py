"""Compare the diagnosis with three simple methods on the same scans (1 hour).

The scans come from the simulator of the blind validation. The simple methods use all repeats:

* `filter`: the effect with the largest matched filter, penalized by BIC, if its p-value over all effects is below 1 %.
* `forward`: forward selection by BIC; each step fits the five effects with the largest matched filters.
* `all`: a fit of all effects at once; effects whose removal would increase the BIC.

`all` omits the gain pattern (one parameter per pixel) and the rotation during a view (several rays per view). A method
reports unexplained data if its chi-square is three standard deviations too large. Cases in the output file are not
repeated.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import simulator_scans
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.fitting.fit import Fitter
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.selection.screening import screened
from virtual_phantom.physics.effect import load
from virtual_phantom.proof.hiding.case import ADMITTED, Case

CHANCE = 0.01
MOST = 4  # steps of the forward selection, as in the diagnosis
FITTED = 5  # fits per step, with the largest matched filters
TOO_MANY = ("gain_pattern", "view_blur")  # omitted by `all`
WAYS = ("diagnosis", "filter", "forward", "all")


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


def answers(truth, config, seed):
    """{method: (ranked effects, whether it reports unexplained data)}."""
    recording, prepared, model = simulator_scans.prepared(truth, config, seed)
    tried = list(candidates(model.settings))
    found = find_missing_physics(recording.name, prepared, tried, config.diagnosis.model_accuracy)
    document = found.content
    equals = [[effect["name"], *document["ambiguous_with"].get(effect["name"], [])] for effect in document["effects"]]
    fitter = without_halves(prepared)
    smooth = [name for name in tried if name not in TOO_MANY]
    rivals = {
        "filter": matched_filter(fitter, tried),
        "forward": forward(fitter, tried),
        "all": all_at_once(fitter, smooth),
    }
    diagnosis = equals, document["verdict"] in ADMITTED
    return {"diagnosis": diagnosis} | {way: ([[name] for name in named], rest) for way, (named, rest) in rivals.items()}


def judged(case, named, rest):
    """{criterion: whether the answer meets it}, by the category of the case."""
    true = [effect["name"] for effect in case.truth["effects"]]
    if case.category == "none":
        return {"no false alarm": not named and not rest}
    if case.category == "unknown":
        equals = [set(equal) for effect in case.truth["effects"] for equal in effect["equals"]]
        return {"owned up": rest or {group[0] for group in named} in equals}
    first = bool(named) and bool(set(named[0]) & set(true))  # or indistinguishable
    every = all(any(name in group for group in named) for name in true)
    return {"first": first, "all": every, "none beside": len(named) == len(true), "no false remainder": not rest}


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    simulator_scans.add_draws(parser, ["medium"], none=6, pairs=5, unknown=7)


def run(options):
    config = common.configuration()
    rows = common.read_jsonl(options.out)
    for case, truth in simulator_scans.left_to_do(options, rows).items():
        rows.append({"truth": truth, "answers": answers(truth, config, options.seed)})
        common.append_jsonl(options.out, rows[-1])
        print(case, [effect["name"] for effect in truth["effects"]], rows[-1]["answers"], flush=True)
    counted: dict[tuple[str, str], dict[str, list[bool]]] = {}
    for row in rows:
        case = Case(row["truth"], {})
        for way in WAYS:
            for measure, right in judged(case, *row["answers"][way]).items():
                counted.setdefault((case.category, measure), {}).setdefault(way, []).append(right)
    for (category, measure), ways in counted.items():
        print(f"{category}, {measure}: " + ", ".join(f"{way} {sum(ok)} of {len(ok)}" for way, ok in ways.items()))
