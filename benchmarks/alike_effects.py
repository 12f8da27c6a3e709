"""Count effects that are ruled out although a refit from another start explains the scan (10 minutes).

Each pair of effects whose templates correlate by 0.9 or more (docs/explanation/theory.md) is tested in both directions.
The simulator of the blind validation hides one effect, and the diagnosis may choose both. If it rules out the other
effect, that effect is fitted again from START_FACTORS times its parameters. The exclusion is false if one of these fits
loses less than RULED_OUT of log score.
"""

import contextlib
from dataclasses import replace

from benchmarks import common
from benchmarks.common import simulator_scans
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.selection.forward_selection import RULED_OUT, choose
from virtual_phantom.proof.hiding.suite import truths

PAIRS = (
    ("centre_of_rotation", "detector_offset"),
    ("motion", "source_distance"),
    ("motion", "source_drift"),
    ("optical_crosstalk", "xray_crosstalk"),
    ("dark_signal", "scatter"),
    ("detector_saturation", "spectrum"),
    ("detector_row_offset", "source_drift"),
    ("focal_spot", "xray_crosstalk"),
)
START_FACTORS = (-2.0, -1.0, -0.3, 0.3, 2.0)


def refitted(fitter, start, rival):
    """Best held-out log score of fits with the rival alone from several starts."""
    fit = trial(fitter, (rival,), start)
    scores = [fit.score]
    for factor in START_FACTORS:
        values = {key: value * factor for key, value in fit.fit.physics[rival].items()}
        begun = replace(fit, fit=replace(fit.fit, physics=fit.fit.physics | {rival: values}))
        with contextlib.suppress(ValueError):  # a negative start of a parameter that is fitted by its logarithm
            scores.append(trial(fitter, (rival,), begun).score)
    return max(scores)


def verdict(fitter, effect, rival):
    """Verdict on the rival in words, and whether it is a false exclusion."""
    start = trial(fitter, ())
    choice = choose(fitter, start, [effect, rival])
    named = choice.chosen.fit.effects
    if effect not in named or rival in named:
        return f"{' and '.join(named) or 'nothing'} named", False
    if rival not in choice.ruled_out:
        ambiguous = rival in choice.ambiguous_with(effect)
        return f"{effect} named, {rival} {'indistinguishable' if ambiguous else 'undecided or worse'}", False
    lost = choice.chosen.score - refitted(fitter, start, rival)
    return f"{effect} named, {rival} ruled out: the best of {1 + len(START_FACTORS)} refits loses {lost:.0f}", bool(
        lost < RULED_OUT and len(named) == 1
    )


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--strength", default="medium")


def run(options):
    config, counts = common.configuration(), [0, 0]
    for pair in PAIRS:
        for effect, rival in (pair, pair[::-1]):
            drawn = {"seed": options.seed, "effects": [effect], "strengths": [options.strength]}
            ((_, truth),) = truths(simulator_scans.proof_settings(drawn | {"none": 0, "unknown": 0})).items()
            _, prepared, _ = simulator_scans.prepared(truth, config, options.seed)
            words, false = verdict(prepared.fitter, effect, rival)
            counts[false] += 1
            print(f"{effect} hidden, {rival} offered: {words}{' FALSE' if false else ''}", flush=True)
    print(f"falsely ruled out: {counts[True]} of {sum(counts)}")
