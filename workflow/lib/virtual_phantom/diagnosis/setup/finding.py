"""Finding of the set-up check: description correct, wrong in one entry, or another object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.errors import InputError
from ..fitting.nuisance import LOCATION
from ..request import LOCATION_DIGITS
from .descriptions import Description, descriptions
from .mismatch import GEOMETRY, Comparison, SetupMismatch

AS_STATED, DESCRIPTION, OBJECT, EMPTY_BEAM = "as stated", "description", "object", "empty"  # kinds of findings
MOST = (36, 8, 96)  # largest number of compared views, rows and columns
COARSE = (24, 6, 48)  # the same for the search of start angles
TURNS_DEG = np.arange(0.0, 360.0, 5.0)  # start angles that are tried
QUARTERS_DEG = (90.0, 180.0, 270.0)  # start angles that are tried if the stated one fits
MOST_TURNS = 3  # minima over start angles that are fitted
# The stated description is accepted if the unexplained share of the variance of line integrals is below MISTAKEN.
# Another one must explain the share REMOVED of the remaining variance (benchmarks/setup_mistakes.py).
MISTAKEN, REMOVED = 1e-4, 0.5
REMOVED_BY_SHIFT = 0.75  # the same for descriptions that shift the detector, as effects do too
LIKELIER = 100.0  # least difference in log likelihood
NAMED = 0.002  # largest remaining share of a named description, with the geometry fitted
ANOTHER = 0.01  # if the remaining share is significantly larger for all descriptions, the object is another one
EMPTY = 0.02  # scale of the line integrals below which the beam was empty
ALIKE = 5.0  # difference in log likelihood from which two descriptions are distinguished
NEAR = 2.0  # ratio of remaining variances up to which ALIKE is tested with the geometry fitted
CONTENDERS = 4  # descriptions that are refitted with the geometry
SCALE_WITHIN = 0.2  # tolerance of the logarithm of a scale factor, as hardening and scatter change it too


@dataclass(frozen=True)
class Finding:
    """Finding of the set-up check.

    Attributes
    ----------
    kind : {"as stated", "description", "object", "empty"}
    best, stated : SetupMismatch
        Mismatch of the best and of the stated description.
    share : float
        Remaining share of the variance of the line integrals for the best description, with the geometry fitted unless
        the share is small.
    alike : tuple of SetupMismatch
        Other descriptions that this object cannot distinguish from the best.
    location : dict of str to float
        Object location, mm by name of LOCATION, if the description is correct but the object is farther from its stated
        location than the alignment allows; otherwise empty.
    """

    kind: str
    best: SetupMismatch
    stated: SetupMismatch
    share: float
    alike: tuple[SetupMismatch, ...] = ()
    location: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SetupResult:
    """Result of the set-up check of a recording.

    Attributes
    ----------
    of : str
        Name of the compared data.
    kind : {"as stated", "description", "object", "empty"}
    mistakes : dict of str to str
        {mistake: correction}.
    alike : tuple of str
        Mistakes that a scan of this object cannot detect.
    share_stated, share : float
        Unexplained share of the variance of the data, as described and as corrected.
    maps : tuple of 2 ndarray, shape (down, across)
        Residual as described and as corrected.
    location : mapping of str to float
        See Finding.location.
    mirrored : bool or None
        Whether an object that is constant along z is seen from its other end; None: not tested.
    """

    of: str
    kind: str
    mistakes: Mapping[str, str]
    alike: tuple[str, ...]
    share_stated: float
    share: float
    maps: tuple[np.ndarray, np.ndarray] = field(repr=False)
    location: Mapping[str, float] = field(default_factory=dict)
    mirrored: bool | None = None

    @property
    def content(self) -> dict:
        """Section `setup` of diagnosis.json."""
        return {
            "of": self.of,
            "kind": self.kind,
            "mistakes": dict(self.mistakes),
            "alike": list(self.alike),
            "share_stated": self.share_stated,
            "share": self.share,
            "location": dict(self.location),
            **({} if self.mirrored is None else {"mirrored": self.mirrored}),
        }


def find(comparison: Comparison, scan: Mapping, log: bool, largest: float) -> Finding:
    """Compare a recording with every plausible description of its scan, for any location of the object.

    The object is fitted at its stated location within the tolerance of the alignment, then in the whole field of view.
    That search starts from the centroids of the views. A grid of locations is tried before another object is reported.
    The stated description is accepted, too, if a motion of the object explains the mismatch.
    """
    given = list(descriptions(scan, log, largest))
    found, stated = _found(comparison, given), given[0]
    in_place = found.stated
    if found.kind in (AS_STATED, DESCRIPTION) and min(found.best.share, found.share) <= MISTAKEN:
        return found
    if found.kind == EMPTY_BEAM and comparison.attenuated(stated) < EMPTY:
        return found
    for by_grid in (False, True):
        anywhere = comparison.anywhere(by_grid)
        no_match = found.kind in (OBJECT, EMPTY_BEAM)
        if by_grid and (not no_match or anywhere.begun(stated) == comparison.anywhere().begun(stated)):
            break  # the grid has no better location
        if not no_match:
            first = anywhere.mismatch(stated)
            if not (comparison.beyond_reach(first) and _explains(first, found.best)):
                break
        other = _found(anywhere, given)
        if other.kind not in (OBJECT, EMPTY_BEAM) and (no_match or _explains(other.best, found.best)):
            found = replace(other, stated=found.stated) if other.kind == DESCRIPTION else other
            if other.kind == AS_STATED and comparison.beyond_reach(other.best):
                found = replace(other, location=_location(anywhere, other.best))
            break
        if no_match and other.share < found.share:
            found = other
    if found.kind == OBJECT:
        moving = comparison.displaced(in_place)
        if not moving.exceeds(ANOTHER):
            return Finding(AS_STATED, in_place, in_place, moving.share)
    return found


def _location(anywhere: Comparison, found: SetupMismatch) -> dict[str, float]:
    """Return the object location, fitted together with a column offset: a half-turn scan confounds the two."""
    shifted = anywhere.mismatch(found.description, also=("columns_px",))
    place = shifted.place if _explains(shifted, found) else found.place
    return {name: round(place[name], LOCATION_DIGITS) + 0.0 for name in LOCATION}


def _explains(other: SetupMismatch, found: SetupMismatch) -> bool:
    """Return whether another location explains significantly more variance."""
    return other.share < (1 - REMOVED) * found.share and found.worse_than(other) > LIKELIER


def _found(comparison: Comparison, given: Sequence[Description]) -> Finding:
    """Return the finding for the locations that a comparison allows; the first description is the stated one."""
    stated, *others = given
    first = comparison.mismatch(stated)
    tried = list(_in_place(comparison, others, first))
    oriented = [mismatch.description for mismatch in (first, *tried) if mismatch.description.oriented]
    tried += _turned(comparison, oriented, _best(first, *tried))
    tried = [mismatch for mismatch in tried if comparison.scaled_right(mismatch) or mismatch.description.scaled]
    chosen = _chosen(comparison, first, tried) or _scaled(first, tried)
    best = chosen or first
    fitted = _with_geometry(comparison, best) if best.exceeds(ANOTHER) else best
    share = fitted.share
    if fitted.exceeds(ANOTHER) or not best.is_visible:
        empty = abs(best.scale) < EMPTY
        if empty or best.is_visible:
            return Finding(EMPTY_BEAM if empty else OBJECT, best, first, share)
    others = [mismatch for mismatch in (first, *tried) if mismatch.name != best.name]
    alike = tuple(_alike(comparison, best, others))
    right = chosen is None and not best.shifted
    return Finding(AS_STATED if right else DESCRIPTION, best, first, share, alike)


def _chosen(comparison: Comparison, first: SetupMismatch, tried: Sequence[SetupMismatch]) -> SetupMismatch | None:
    """Return the description that replaces the stated one, or None."""
    chosen = _mistake(first, tried)
    if chosen is not None and not chosen.description.shifts:
        # For a round object, a detector offset looks like other angles. A mistake without a fitted parameter that
        # explains more than a fitted geometry is no coincidence.
        fitted = _with_geometry(comparison, first)
        exact = not chosen.turned and chosen.worse_than(fitted) < 0
        chosen = chosen if exact else _mistake(fitted, [chosen], least=0.0)
    elif chosen is None and min(mismatch.share for mismatch in (first, *tried)) > MISTAKEN:
        # Physics that shifts or stretches the rays may hide a mistake or look like one. If a description explains no
        # more than the stated one, more geometry may only end in another minimum.
        likelier = [mismatch for mismatch in tried if first.worse_than(mismatch) > LIKELIER]
        nearest = sorted(likelier, key=lambda mismatch: mismatch.share)[:CONTENDERS]
        fitted, *others = (_with_geometry(comparison, mismatch) for mismatch in (first, *nearest))
        chosen = _mistake(fitted, others, least=0.0)
    if chosen is not None and chosen.share > NAMED and _with_geometry(comparison, chosen).share > NAMED:
        return None  # any object of similar size would explain as much
    return chosen


def _mistake(stated: SetupMismatch, others: Sequence[SetupMismatch], least: float = MISTAKEN) -> SetupMismatch | None:
    """Return the description that explains a residual share above `least` of the stated one, or None."""
    if not others or stated.share <= least:
        return None
    best = _best(*others)
    removed = REMOVED_BY_SHIFT if best.description.shifts else REMOVED
    explained = best.share < min((1 - removed) * stated.share, ANOTHER)
    return best if explained and stated.worse_than(best) > LIKELIER else None


def _alike(comparison: Comparison, best: SetupMismatch, others: Sequence[SetupMismatch]) -> Iterator[SetupMismatch]:
    """Yield the descriptions that this object cannot distinguish from the best one.

    Missing physics such as a detector shift may make equivalent descriptions look different. Descriptions with a
    similar mismatch are therefore compared with the geometry fitted.
    """
    yield from (other for other in others if other.worse_than(best) < ALIKE)
    near = [other for other in others if other.worse_than(best) >= ALIKE and other.share < NEAR * best.share]
    if near and best.share > MISTAKEN:
        fitted = _with_geometry(comparison, best)
        near.sort(key=lambda other: other.share)
        yield from (
            other for other in near[:CONTENDERS] if abs(_with_geometry(comparison, other).worse_than(fitted)) < ALIKE
        )


def _with_geometry(comparison: Comparison, found: SetupMismatch) -> SetupMismatch:
    """Return the mismatch with the geometry fitted."""
    again = comparison.mismatch(found.description, found.place["turn_deg"] if found.turned else 0.0, also=GEOMETRY)
    return _best(found, again)


def _best(*found: SetupMismatch) -> SetupMismatch:
    return min(found, key=lambda mismatch: mismatch.share)


def _in_place(comparison: Comparison, given: Sequence[Description], best: SetupMismatch) -> Iterator[SetupMismatch]:
    for description in given:
        try:
            found = comparison.mismatch(description, best=best)
        except InputError:  # impossible lengths
            continue
        yield found
        best = _best(best, found)


def _turned(comparison: Comparison, given: Sequence[Description], best: SetupMismatch) -> Iterator[SetupMismatch]:
    """Yield the mismatch of each description at its best start angles.

    If a description fits already, only quarter turns of the stated one are tested, as the object may be symmetric.
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
            found = comparison.mismatch(description, float(turn), best)
            yield found
            best = _best(best, found)


def _scaled(stated: SetupMismatch, tried: Sequence[SetupMismatch]) -> SetupMismatch | None:
    """Return the description whose factor of the line integrals is observed, or None."""
    for mismatch in tried:
        factor = mismatch.description.scaled
        if factor is not None and abs(np.log(max(stated.scale, EMPTY) * factor)) < SCALE_WITHIN:
            return mismatch
    return None
