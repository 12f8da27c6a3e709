"""Whether a piece of the object differs from what was stated, where no physics explains the data as well.

A wrong object is the commonest mismatch of real work. Of a scan of one object it cannot be shown: physics that nobody
knows might look the same. So it is named, effects are named no more, and whoever made the scan says whether the
diagnosis is to go on with the object mended.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting.fit import Fit
from ..fitting.trial import Trial
from ..residuals.change import Change
from ..residuals.dataset import Prepared
from ..residuals.residual_tests import ALPHA
from ..selection.forward_selection import AS_GOOD, LEAST_GAIN, Choice
from ..selection.screening import Screened
from .unmodelled import ChangesOfFits

MOST_PIECES = 3  # that are mended; an object that differs in more is another object
BEYOND = 2.0  # times what the best effect gains to first order: a fit may gain twice as much
# Standard deviations of noise, of chi-square, by which a difference is so large that what leaves no more than NOISE of
# them explains all of it, which physics of the whole object does not by chance.
FAR, NOISE = 100.0, 3.0


def differing(found: Sequence[Change], least: float = LEAST_GAIN) -> Change | None:
    """The piece of the object, if it is no chance and explains more of the data held out than any other kind of change.

    Parameters
    ----------
    found : sequence of Change
        As outside.changes gives them.
    least : float, optional
        Log score that it must gain.

    Returns
    -------
    Change or None
        None where there is none.
    """
    piece = _piece(found)
    if piece is None or piece.p * len(found) > ALPHA or piece.gain < least:
        return None
    return piece if piece.gain == max(one.gain for one in found) else None


def beyond_effects(piece: Change, alone: Mapping[str, Screened]) -> bool:
    """Whether a piece explains more than any effect could, by the effects' matched filters beside the alignment."""
    # The gain is of chi-square, twice the log score.
    return piece.gain > BEYOND * max((one.gain / 2 for one in alone.values()), default=0.0)


def explains_all(piece: Change, prepared: Prepared, baseline: Trial) -> bool:
    """Whether an object with the piece leaves nothing of a large difference: no physics could explain more.

    Parameters
    ----------
    baseline : Trial
        Alignment alone.
    """
    before, noise = excess(prepared, baseline.fit), np.sqrt(_count(prepared) / 2)
    if before < FAR * noise or piece.gain < before / 2:  # the gain is of first order
        return False
    mended = prepared.with_piece(piece.piece, baseline.fit)
    return excess(mended, mended.fitter.fit(())) < NOISE * noise


def excess(prepared: Prepared, fit: Fit) -> float:
    """Log score of the data held out that what a fit leaves of their mean costs beyond noise."""
    half = prepared.half(fit, held_out=True)
    return float((half.weights[0] * half.residuals[0] ** 2).sum() - _count(prepared)) / 2


def _count(prepared: Prepared) -> int:
    """Of the data held out, but for what is known of their noise."""
    return int((prepared.fitter.held_weights[0] > 0).sum())


def better_than(piece: Change, choice: Choice) -> bool:
    """Whether a piece explains more than all effects that were chosen do together."""
    return piece.gain > choice.chosen.score - choice.baseline.score + max(AS_GOOD, choice.blur)


def no_physics(baseline: Trial, piece: Change, numerical: float) -> Choice:
    """The choice of no effect, since a piece of the object explains more.

    Parameters
    ----------
    baseline : Trial
        Alignment alone.
    numerical : float
        As Choice has it.
    """
    return Choice(baseline, {}, {}, baseline, {}, {}, {}, numerical=numerical, piece=piece)


def beside(prepared: Prepared, choice: Choice, changes: ChangesOfFits) -> Change | None:
    """The piece of the object that explains more than one of the chosen effects, or what all of them leave."""
    found, least = [], max(AS_GOOD, choice.blur)
    for effect, fit in choice.without.items():
        piece = _piece(changes(prepared, fit, choice.numerical))
        if piece is not None and piece.gain > choice.gains[effect] + least:
            found.append((piece.gain - choice.gains[effect], piece))
    if found:
        return max(found, key=lambda one: one[0])[1]
    return differing(changes(prepared, choice.chosen.fit, choice.numerical), max(LEAST_GAIN, choice.blur))


def _piece(found: Sequence[Change]) -> Change | None:
    return next((one for one in found if one.piece is not None), None)


def content_of(pieces: Sequence[Change], mended: bool, excess: float | None = None) -> dict:
    """What diagnosis.json holds of pieces of the object.

    Parameters
    ----------
    mended : bool
        Whether the diagnosis went on with them.
    excess : float, optional
        Log score of the data held out that is beyond noise, of which the first piece takes a share.
    """
    listed = [{**one.piece.content, "what": one.words, "held_out_gain": one.gain, "z": one.z} for one in pieces]
    removes = {} if excess is None else {"removes": min(1.0, pieces[0].gain / max(excess, pieces[0].gain))}
    return {"mended": mended, "pieces": listed} | removes
