"""Whether a piece of the object differs from what was stated, where no physics explains the data as well.

A wrong object is the commonest mismatch of real work. Of a scan of one object it cannot be shown: physics that nobody
knows might look the same. So it is named, effects are named no more, and whoever made the scan says whether the
diagnosis is to go on with the object mended.
"""

from __future__ import annotations

from collections.abc import Sequence

from .attribute import LEAST_GAIN, Choice
from .how_far import HowFar
from .locate import ALPHA
from .outside import Change, changes
from .prepared import Prepared
from .screening import screened
from .trial import Trial
from .trials import trials

MOST_PIECES = 3  # that are mended; an object that differs in more is another object
BEYOND = 2.0  # times what the best effect gains to first order: a fit may gain twice as much


def differing(
    prepared: Prepared,
    baseline: Trial,
    effects: Sequence[str],
    numerical: float,
    processes: int = 1,
    how_far: HowFar | None = None,
) -> Change | None:
    """The piece of the object whose change explains more of the data held out than any effect could.

    Parameters
    ----------
    prepared : Prepared
    baseline : Trial
        Alignment alone.
    effects : sequence of str
        Candidates.
    numerical : float
        As `changes` takes it.
    processes, how_far
        As `screened` takes them.

    Returns
    -------
    Change or None
        None where there is none, or where an effect or another kind of change might do as well.
    """
    found = changes(prepared, baseline.fit, numerical)
    piece = next((one for one in found if one.piece is not None), None)
    if piece is None or piece.p * len(found) > ALPHA or piece.gain < LEAST_GAIN:
        return None
    if piece.gain <= max((one.gain for one in found if one is not piece), default=0.0):
        return None
    alone = screened(prepared.fitter, baseline.fit, effects, processes=processes, how_far=how_far) if effects else {}
    # The gain is of chi-square, twice the log score.
    best = max((one.gain / 2 for one in alone.values()), default=0.0)
    return piece if piece.gain > BEYOND * best else None


def no_physics(baseline: Trial, piece: Change) -> Choice:
    """The choice of no effect, since a piece of the object explains more."""
    return Choice(baseline, {}, {}, baseline, {}, {}, {}, piece=piece)


def mended(
    prepared: Prepared,
    effects: Sequence[str],
    numerical: float,
    processes: int = 1,
    widest_mm: float = float("inf"),
) -> tuple[Prepared, list[Change]]:
    """The recording of an object in which pieces are what the data say.

    Parameters
    ----------
    prepared, effects, numerical, processes
        As `differing` takes them.
    widest_mm : float, optional
        Of a piece.

    Returns
    -------
    prepared : Prepared
    pieces : list of Change
        At most MOST_PIECES, in the order in which they were found.
    """
    pieces: list[Change] = []
    while len(pieces) < MOST_PIECES:
        (baseline,) = trials(prepared.fitter, [((),)])
        one = differing(prepared, baseline, effects, numerical, processes)
        if one is None or one.piece.content["width_mm"] > widest_mm:
            break
        prepared = prepared.with_piece(one.piece)
        pieces.append(one)
    return prepared, pieces


def content_of(pieces: Sequence[Change], mended: bool, excess: float | None = None) -> dict:
    """What diagnosis.json holds of pieces of the object.

    Parameters
    ----------
    pieces : sequence of Change
    mended : bool
        Whether the diagnosis went on with them.
    excess : float, optional
        Log score of the data held out that is beyond noise, of which the first piece takes a share.

    Returns
    -------
    dict
    """
    listed = [{**one.piece.content, "what": one.words, "held_out_gain": one.gain, "z": one.z} for one in pieces]
    removes = {} if excess is None else {"removes": min(1.0, pieces[0].gain / max(excess, pieces[0].gain))}
    return {"mended": mended, "pieces": listed} | removes
