"""Whether an effect that imitates the hidden one is ruled out although a refit from another start explains the scan.

    python benchmarks/alike_effects.py --seed 120

Each pair of effects whose templates correlate by 0.9 or more (docs/explanation/theory.md, section 3) is tried in both
directions: a small scan by the simulator of the blind validation hides one effect, and both are offered to the
diagnosis. Where the other one is ruled out, it is fitted again from START_FACTORS times its fitted parameters. "Ruled
out" is false if one of these fits loses less than RULED_OUT of log score.
"""

import argparse
import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path

import lacking

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
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
    """The best held-out log score of fits with the rival alone that begin at several settings."""
    fit = trial(fitter, (rival,), start)
    scores = [fit.score]
    for factor in START_FACTORS:
        values = {key: value * factor for key, value in fit.fit.physics[rival].items()}
        begun = replace(fit, fit=replace(fit.fit, physics=fit.fit.physics | {rival: values}))
        with contextlib.suppress(ValueError):  # a negative start of a parameter that is fitted by its logarithm
            scores.append(trial(fitter, (rival,), begun).score)
    return max(scores)


def verdict(fitter, effect, rival):
    """What the choice says of the rival, in words, and whether that is false."""
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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--strength", default="medium")
    options = parser.parse_args()
    config, counts = lacking.default_config(), [0, 0]
    for pair in PAIRS:
        for effect, rival in (pair, pair[::-1]):
            drawn = {"seed": options.seed, "effects": [effect], "strengths": [options.strength]}
            ((_, truth),) = truths(lacking.asked_of_proof(drawn | {"none": 0, "unknown": 0})).items()
            with tempfile.TemporaryDirectory() as folder:
                model = lacking.recorded(Path(folder), truth, config, options.seed)
                _, prepared = prepare_recording(DiagnosisRequest.of(model, str(Path(folder) / "image.nii.gz"), 1))
                words, false = verdict(prepared.fitter, effect, rival)
            counts[false] += 1
            print(f"{effect} hidden, {rival} offered: {words}{' FALSE' if false else ''}", flush=True)
    print(f"falsely ruled out: {counts[True]} of {sum(counts)}")


if __name__ == "__main__":
    main()
