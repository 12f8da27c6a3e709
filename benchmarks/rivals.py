"""The diagnosis against simple rivals, on the same recordings.

    python benchmarks/rivals.py --seed 51 --out rivals.jsonl

Scans by the proof's simulator as lacking.py has them: every effect of --effects alone, nothing, pairs and faults that
the library lacks. The rivals see both halves of the repeats, and know of no numerical error beyond what is fitted:

* `filter`: the effect with the largest matched filter beside the alignment, less numbers times ln(data), if its chance
  is under 1 % over all.
* `forward`: effects one after the other, each time the best by chi-square plus numbers times ln(data) (BIC), while that
  falls; each time the five of the largest matched filters beside the last fit are fitted.
* `all`: all effects fitted at once, each begun where it alone fits best; those whose removal would raise the same sum,
  by their standard errors.

A gain pattern has as many numbers as there are pixels; `all` goes without it, and without rotation during a view, for
which every view would be traced several times. A rival owns up to a fault if chi-square
of its last fit is above the number of data by more than three standard deviations.
Cases that the file has already are not done again.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import lacking
import numpy as np

from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.fitting.fit import Fitter
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.selection.screening import screened
from virtual_phantom.physics.effect import load
from virtual_phantom.proof.hiding.case import ADMITTED, Case

CHANCE = 0.01
MOST = 4  # effects that a rival takes one after the other, as many as the diagnosis names
FITTED = 5  # effects that are fitted for each of them, those of the largest matched filters
TOO_MANY = ("gain_pattern", "view_blur")  # not among all at once: as many numbers as pixels, as many rays as moments
WAYS = ("ours", "filter", "forward", "all")


def without_halves(prepared):
    """A fitter of all repeats, whose weights hold noise alone."""
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
    """Whether chi-square says that something is left."""
    count = sum(int((weight > 0).sum()) for weight in fitter.weights)
    return bool(fit.chi_square - count > 3 * np.sqrt(2 * count))


def priced(fitter):
    """ln(data); and numbers that an effect has beside its parameters: a pattern's constants, one for each pixel."""
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
    alone = {name: fitter.fit((name,), aligned).physics[name] for name in tried}  # all starts of all would be millions
    fit = fitter.fit(tuple(tried), replace(aligned, physics=alone), from_farther=False)
    worth = {}
    for name in tried:
        pulls = [
            ((fit.physics[name][one.name] - one.neutral) / fit.errors[name][one.name]) ** 2
            for one in fitter.model.parameters(name)
            if one.neutral is not None and fit.errors[name].get(one.name)
        ]
        if pulls:
            worth[name] = sum(pulls) - price * len(pulls)
    named = sorted((name for name, one in worth.items() if one > 0), key=lambda name: -worth[name])
    return named, left(fitter, fit)


def answers(folder, truth, config, seed):
    """{way: (effects named, first the surest; whether something is left)}."""
    model = lacking.recorded(folder, truth, config, seed)
    tried = list(candidates(model["settings"]))
    recording, prepared = prepare_recording(DiagnosisRequest.of(model, str(folder / "image.nii.gz"), 1))
    found = find_missing_physics(recording.name, prepared, tried, config["diagnosis"]["model_accuracy"])
    said = found.content
    equals = [[one["name"], *said["ambiguous_with"].get(one["name"], [])] for one in said["effects"]]
    fitter = without_halves(prepared)
    smooth = [name for name in tried if name not in TOO_MANY]
    rivals = {
        "filter": matched_filter(fitter, tried),
        "forward": forward(fitter, tried),
        "all": all_at_once(fitter, smooth),
    }
    ours = equals, said["verdict"] in ADMITTED
    return {"ours": ours} | {way: ([[name] for name in named], rest) for way, (named, rest) in rivals.items()}


def judged(case, named, rest):
    """What of a case an answer has right, by the category's measure."""
    true = [one["name"] for one in case.truth["effects"]]
    if case.category == "none":
        return {"no false alarm": not named and not rest}
    if case.category == "unknown":
        equals = [set(equal) for one in case.truth["effects"] for equal in one["equals"]]
        return {"owned up": rest or {group[0] for group in named} in equals}
    first = bool(named) and bool(set(named[0]) & set(true))  # or as its equal
    every = all(any(name in group for group in named) for name in true)
    return {"first": first, "all": every, "none beside": len(named) == len(true), "no false remainder": not rest}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    lacking.add_draws(parser, ["medium"], none=6, pairs=5, unknown=7)
    options = parser.parse_args()
    config = lacking.default_config()
    rows = lacking.rows_of(options.out)
    for case, truth in lacking.left_to_do(options, rows).items():
        with tempfile.TemporaryDirectory() as folder:
            rows.append({"truth": truth, "answers": answers(Path(folder), truth, config, options.seed)})
        lacking.append(options.out, rows[-1])
        print(case, [one["name"] for one in truth["effects"]], rows[-1]["answers"], flush=True)
    counted: dict[tuple[str, str], dict[str, list[bool]]] = {}
    for row in rows:
        case = Case(row["truth"], {})
        for way in WAYS:
            for measure, right in judged(case, *row["answers"][way]).items():
                counted.setdefault((case.category, measure), {}).setdefault(way, []).append(right)
    for (category, measure), ways in counted.items():
        print(f"{category}, {measure}: " + ", ".join(f"{way} {sum(ok)} of {len(ok)}" for way, ok in ways.items()))


if __name__ == "__main__":
    main()
