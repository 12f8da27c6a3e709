"""What a recording says of its own description: right, wrong in this line, or of another object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.errors import InputError
from ..fitting.nuisance import LOCATION
from .descriptions import Description, descriptions
from .mismatch import GEOMETRY, Comparison, SetupMismatch

AS_STATED, DESCRIPTION, OBJECT, EMPTY_BEAM = "as stated", "description", "object", "empty"  # kinds of findings
MOST = (36, 8, 96)  # views, rows and columns that are compared
COARSE = (24, 6, 48)  # the same, of start angles
TURNS_DEG = np.arange(0.0, 360.0, 5.0)  # where the others are looked for
QUARTERS_DEG = (90.0, 180.0, 270.0)  # start angles that are looked at where the stated one fits
MOST_TURNS = 3  # minima over turns that are fitted
# Shares of the variance of line integrals (benchmarks/setup_mistakes.py says what mistakes, physics and other objects
# leave): below the first no description is doubted; of what the stated one leaves, another must explain so much.
MISTAKEN, REMOVED = 1e-4, 0.5
REMOVED_BY_SHIFT = 0.75  # the same of descriptions that shift the detector: effects of the library come near them
LIKELIER = 100.0  # log likelihood by which it must be ahead, where both have the geometry fitted and leave little
NAMED = 0.002  # that a description may leave, the geometry fitted, to be named
ANOTHER = 0.01  # left by every description, whatever the geometry: another object
EMPTY = 0.02  # scale of the line integrals below which nothing stood in the beam
ALIKE = 5.0  # log likelihood by which this object must tell two descriptions apart
NEAR = 2.0  # times as much left: of descriptions for which that is tried with the geometry fitted
CONTENDERS = 4  # descriptions that are fitted with the geometry
LOCATION_DIGITS = 1  # of a location that is found, mm: the alignment is fitted from there
SCALE_WITHIN = 0.2  # logarithm of a factor that line integrals are off by: hardening and scatter change them too


@dataclass(frozen=True)
class Finding:
    """What was found.

    Attributes
    ----------
    kind : {"as stated", "description", "object", "empty"}
    best, stated : Unlike
        What fits best, and the recording as it is described.
    share : float
        Of the variance of the line integrals, what the best description leaves where the geometry is fitted too; its
        own where that is little.
    alike : tuple of SetupMismatch
        Other descriptions that fit as well: this object cannot tell them from the best.
    location : dict of str to float
        Where the object lies, mm by name of LOCATION, if it lies farther off its stated location than the alignment
        allows and the scan is described right; empty otherwise.
    """

    kind: str
    best: SetupMismatch
    stated: SetupMismatch
    share: float
    alike: tuple[SetupMismatch, ...] = ()
    location: Mapping[str, float] = field(default_factory=dict)


def find(comparison: Comparison, scan: Mapping, log: bool, largest: float) -> Finding:
    """Compare a recording with every description of it that could be meant, wherever the object lies.

    First the object is looked for where it is stated, within what the alignment allows, then in the whole field of
    view: by the centroids of the views, and, before another object is named, on a grid of locations.

    Parameters
    ----------
    scan : mapping
        The scan section of recording.yaml.
    largest : float
        As descriptions takes them.
    """
    found = _found(comparison, scan, log, largest)
    if found.kind in (AS_STATED, DESCRIPTION) and min(found.best.share, found.share) <= MISTAKEN:
        return found
    stated = next(descriptions(scan, log, largest))
    if found.kind == EMPTY_BEAM and comparison.attenuated(stated) < EMPTY:
        return found
    for by_grid in (False, True):
        anywhere = comparison.anywhere(by_grid)
        lost = found.kind in (OBJECT, EMPTY_BEAM)
        if by_grid and (not lost or anywhere.begun(stated) == comparison.anywhere().begun(stated)):
            break  # the grid has nothing better
        if not lost:
            first = anywhere.unlike(stated)
            if not (comparison.beyond_reach(first) and _explains(first, found.best)):
                break
        other = _found(anywhere, scan, log, largest)
        if other.kind not in (OBJECT, EMPTY_BEAM) and (lost or _explains(other.best, found.best)):
            found = replace(other, stated=found.stated) if other.kind == DESCRIPTION else other
            if other.kind == AS_STATED and comparison.beyond_reach(other.best):
                found = replace(other, location=_location(anywhere, other.best))
            break
        if lost and other.share < found.share:
            found = other
    return found


def _location(anywhere: Comparison, found: SetupMismatch) -> dict[str, float]:
    """Where the object lies; a shift of the detector, which a scan of half a turn trades against it, is fitted too."""
    shifted = anywhere.unlike(found.description, also=("columns_px",))
    place = shifted.place if _explains(shifted, found) else found.place
    return {name: round(place[name], LOCATION_DIGITS) + 0.0 for name in LOCATION}


def _explains(other: SetupMismatch, found: SetupMismatch) -> bool:
    """Whether another location explains more of the unexplained variance than chance would."""
    return other.share < (1 - REMOVED) * found.share and found.worse_than(other) > LIKELIER


def _found(comparison: Comparison, scan: Mapping, log: bool, largest: float) -> Finding:
    """As `find`, at the locations that a comparison allows."""
    stated, *others = descriptions(scan, log, largest)
    first = comparison.unlike(stated)
    tried = list(_in_place(comparison, others, first))
    oriented = [one.description for one in (first, *tried) if one.description.oriented]
    tried += _turned(comparison, oriented, _best(first, *tried))
    tried = [one for one in tried if comparison.scaled_right(one) or one.description.scaled]
    chosen = _chosen(comparison, first, tried) or _scaled(first, tried)
    best = chosen or first
    share = best.share if best.share <= ANOTHER else _bent(comparison, best).share
    if share > ANOTHER:
        empty = abs(best.scale) < EMPTY
        return Finding(EMPTY_BEAM if empty else OBJECT, best, first, share)
    others = [one for one in (first, *tried) if one.name != best.name]
    alike = tuple(_alike(comparison, best, others))
    right = chosen is None and not best.shifted
    return Finding(AS_STATED if right else DESCRIPTION, best, first, share, alike)


def _chosen(comparison: Comparison, first: SetupMismatch, tried: Sequence[SetupMismatch]) -> SetupMismatch | None:
    """The description to name in the place of the stated one, if there is one."""
    chosen = _mistake(first, tried)
    if chosen is not None and not chosen.description.shifts:
        # On a round object an offset of the detector looks like other angles. A mistake that has no number to fit and
        # is as near as a fitted geometry is no chance.
        bent = _bent(comparison, first)
        exact = not chosen.turned and chosen.worse_than(bent) < 0
        chosen = chosen if exact else _mistake(bent, [chosen], least=0.0)
    elif chosen is None and min(one.share for one in (first, *tried)) > MISTAKEN:
        # Physics that shifts or stretches the rays may hide what a mistake leaves, or pass for it.
        nearest = sorted(tried, key=lambda one: one.share)[:CONTENDERS]
        bent, *others = (_bent(comparison, one) for one in (first, *nearest))
        chosen = _mistake(bent, others, least=0.0)
    if chosen is not None and chosen.share > NAMED and _bent(comparison, chosen).share > NAMED:
        return None  # nearer, as something else of about that size would be
    return chosen


def _mistake(stated: SetupMismatch, others: Sequence[SetupMismatch], least: float = MISTAKEN) -> SetupMismatch | None:
    """The description that explains what the stated one leaves, if that is more than `least` and one does."""
    if not others or stated.share <= least:
        return None
    best = _best(*others)
    removed = REMOVED_BY_SHIFT if best.description.shifts else REMOVED
    explained = best.share < min((1 - removed) * stated.share, ANOTHER)
    return best if explained and stated.worse_than(best) > LIKELIER else None


def _alike(comparison: Comparison, best: SetupMismatch, others: Sequence[SetupMismatch]) -> Iterator[SetupMismatch]:
    """Descriptions that this object cannot tell from the best one.

    What physics leaves, a shift of the detector say, may part two that are alike: near ones have the geometry fitted.
    """
    yield from (one for one in others if one.worse_than(best) < ALIKE)
    near = [one for one in others if one.worse_than(best) >= ALIKE and one.share < NEAR * best.share]
    if near and best.share > MISTAKEN:
        bent = _bent(comparison, best)
        near.sort(key=lambda one: one.share)
        yield from (one for one in near[:CONTENDERS] if abs(_bent(comparison, one).worse_than(bent)) < ALIKE)


def _bent(comparison: Comparison, found: SetupMismatch) -> SetupMismatch:
    """The same with the geometry fitted too."""
    again = comparison.unlike(found.description, found.place["turn_deg"] if found.turned else 0.0, also=GEOMETRY)
    return _best(found, again)


def _best(*found: SetupMismatch) -> SetupMismatch:
    return min(found, key=lambda one: one.share)


def _in_place(comparison: Comparison, given: Sequence[Description], best: SetupMismatch) -> Iterator[SetupMismatch]:
    for description in given:
        try:
            found = comparison.unlike(description, best=best)
        except InputError:  # lengths that no scanner has
            continue
        yield found
        best = _best(best, found)


def _turned(comparison: Comparison, given: Sequence[Description], best: SetupMismatch) -> Iterator[SetupMismatch]:
    """Each description with the start angles at which it fits best.

    Where one fits already, only quarter turns of the stated one are looked at: of an object that cannot tell them.
    """
    coarse = comparison.coarser(COARSE)
    if best.share <= MISTAKEN:
        given, turns = given[:1], np.array((0.0, *QUARTERS_DEG))
    else:
        turns = TURNS_DEG
    for description in given:
        left = coarse.at_turns(description, turns)
        lowest = (left <= np.roll(left, 1)) & (left <= np.roll(left, -1)) if len(turns) > 4 else left <= 2 * left[0]
        lowest[0] = False  # fitted already
        for turn in turns[lowest][np.argsort(left[lowest])][:MOST_TURNS]:
            found = comparison.unlike(description, float(turn), best)
            yield found
            best = _best(best, found)


def _scaled(stated: SetupMismatch, tried: Sequence[SetupMismatch]) -> SetupMismatch | None:
    """A description by which line integrals are off by a factor alone, if they are."""
    for one in tried:
        factor = one.description.scaled
        if factor is not None and abs(np.log(max(stated.scale, EMPTY) * factor)) < SCALE_WITHIN:
            return one
    return None
