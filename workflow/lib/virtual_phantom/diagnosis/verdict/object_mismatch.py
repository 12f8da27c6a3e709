"""Local object mismatch: a ball or rod in which the object differs, and which explains the data better than physics.

A wrong object is the most frequent mismatch. A scan of one object cannot prove that the object is wrong, because
unknown physics might look the same. The mismatch is therefore reported without any effect, and the user decides whether
the diagnosis continues with a corrected object (`object_may_differ`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting.fit import Fit
from ..fitting.trial import Trial
from ..residuals.dataset import Change, Prepared
from ..residuals.residual_tests import ALPHA
from ..selection.forward_selection import AS_GOOD, LEAST_GAIN, Choice
from ..selection.screening import Screened
from .unmodeled import ChangesOfFits

MOST_MISMATCHES = 3  # local mismatches that are corrected; with more, the stated object is wrong
BEYOND = 2.0  # ratio to the first-order gain of the best effect, as a fit may gain twice as much
# A mismatch explains everything if it reduces a difference above FAR to less than NOISE, both in standard deviations of
# the noise of chi-square. A mismatch cannot do so by chance if the cause is physics of the whole object.
FAR, NOISE = 100.0, 3.0


def differing(found: Sequence[Change], least: float = LEAST_GAIN) -> Change | None:
    """Return the local object mismatch if it is significant and explains more held-out data than any other change."""
    local = _local(found)
    if local is None or local.p * len(found) > ALPHA or local.gain < least:
        return None
    return local if local.gain == max(change.gain for change in found) else None


def beyond_effects(local: Change, alone: Mapping[str, Screened]) -> bool:
    """Return whether a mismatch explains more than any effect could, from the matched filters of the effects."""
    # The gain of an effect is in chi-square, twice the log score.
    return local.gain > BEYOND * max((effect.gain / 2 for effect in alone.values()), default=0.0)


def explains_all(local: Change, prepared: Prepared, aligned: Fit) -> bool:
    """Return whether the corrected object explains all of a large difference, which a fit without effects leaves."""
    before, noise = excess(prepared, aligned), np.sqrt(_count(prepared) / 2)
    if before < FAR * noise or local.gain < before / 2:  # the gain is of first order
        return False
    corrected = prepared.with_mismatch(local.mismatch, aligned)
    return excess(corrected, corrected.fitter.fit(())) < NOISE * noise


def excess(prepared: Prepared, fit: Fit) -> float:
    """Return the held-out log score that the residual of a fit costs beyond noise."""
    half = prepared.half(fit, held_out=True)
    return float((half.weights[0] * half.residuals[0] ** 2).sum() - _count(prepared)) / 2


def _count(prepared: Prepared) -> int:
    """Return the number of held-out data of the mean."""
    return int((prepared.fitter.held_weights[0] > 0).sum())


def better_than(local: Change, choice: Choice) -> bool:
    """Return whether a mismatch explains more than all chosen effects together."""
    return local.gain > choice.chosen.score - choice.baseline.score + max(AS_GOOD, choice.tolerance)


def no_physics(baseline: Trial, local: Change, numerical: float) -> Choice:
    """Return a choice without effects, for a local object mismatch that explains more."""
    return Choice(baseline, chosen=baseline, numerical=numerical, mismatch=local)


def mismatch_beside_effects(prepared: Prepared, choice: Choice, changes: ChangesOfFits) -> Change | None:
    """Return the local object mismatch that explains more than one of the chosen effects.

    Without such a mismatch, return the one that explains the remaining residual, if there is one.
    """
    found, least = [], max(AS_GOOD, choice.tolerance)
    for effect, fit in choice.without.items():
        local = _local(changes(prepared, fit, choice.numerical))
        if local is not None and local.gain > choice.gains[effect] + least:
            found.append((local.gain - choice.gains[effect], local))
    if found:
        return max(found, key=lambda advantage: advantage[0])[1]
    return differing(changes(prepared, choice.chosen.fit, choice.numerical), max(LEAST_GAIN, choice.tolerance))


def _local(found: Sequence[Change]) -> Change | None:
    return next((change for change in found if change.mismatch is not None), None)


def content_of(corrected: Sequence[Change], excess: float | None = None) -> dict:
    """Return section `object` of diagnosis.json.

    Parameters
    ----------
    excess : float, optional
        Held-out log score beyond noise, of which the first mismatch explains a share; None: the diagnosis continued
        with the corrected object.
    """
    listed = [
        {**local.mismatch.content, "what": local.words, "held_out_gain": local.gain, "z": local.z}
        for local in corrected
    ]
    removes = {} if excess is None else {"removes": min(1.0, corrected[0].gain / max(excess, corrected[0].gain))}
    return {"corrected": excess is None, "pieces": listed} | removes
