"""Which property of the images explains that features miss a recording's, judged on regions that were not fitted.

The strength of every property is fitted on half of the regions and judged on the others, and the other way round.
Repeats cannot be held out for that: what differs is the same in all of them.

A property might also remove part of a difference that it has nothing to do with, as textures go together. So every
property is tried on differences of no cause as well: random shifts, alike in all regions, as correlated between
features as repeats are, in each cell as large as properties make them, and in all as large as what was found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ...base.streams import generator
from ...statistics.comparison import ALPHA
from ...statistics.multiplicity import holm
from .properties import FOLDS, Property
from .responses import Curve, Responses, finer, removed, weight

DRAWS = 999  # of a permutation test: p down to 0.001
MATERIAL = 0.1  # share of the excess on held-out regions that a property must remove
AS_GOOD = 0.05  # of a paired t-test over regions: what is not worse at this level stands as well
# A property without a strength was fitted to the recording by its own numbers, and is so to a random difference.
SCALES = np.linspace(-2, 2, 17)


@dataclass(frozen=True)
class Trial:
    """A property on held-out regions.

    Attributes
    ----------
    strengths : dict of int to float
        {fold: strength fitted on that fold}.
    fitted, held_out : float
        Share of the excess removed on the ROIs that were fitted, and on the others.
    regions : ndarray, shape (rois,)
        What each adds to `held_out`.
    p : float
        Chance of as much from a difference of no cause, corrected over properties (Holm).
    kept, after : ndarray, shape (repeats, rois, features)
        Features on the ROIs that were fitted, and on held-out ones.
    """

    strengths: dict[int, float]
    fitted: float
    held_out: float
    regions: np.ndarray
    p: float
    kept: np.ndarray
    after: np.ndarray

    @property
    def counts(self) -> bool:
        """Whether it explains anything."""
        return self.p < ALPHA and self.held_out >= MATERIAL


def trials(data: Responses, seed: int = 0) -> dict[Property, Trial]:
    """Try every property.

    Parameters
    ----------
    seed : int, optional
        Of random differences.

    Returns
    -------
    dict of Property to Trial
        The best first.
    """
    before = shift(data, data.baseline)
    curves = _curves(data)
    moved = {one: _moved(data, before, own) for one, own in curves.items()}
    chance = _chance(data, before, moved, seed)
    total = weight(before, data.floor).sum()
    found = {}
    for (one, own), p in zip(curves.items(), chance, strict=True):
        chosen = _chosen(data, before, moved[one])
        gains = {fold: removed(before, before + moved[one][fold][index], data.floor) for fold, index in chosen.items()}
        kept = sum(np.where((data.fold == fold)[:, None], gains[fold], 0.0) for fold in FOLDS)
        held = sum(np.where((data.fold != fold)[:, None], gains[fold], 0.0) for fold in FOLDS)
        found[one] = Trial(
            {fold: float(own[fold].strengths[index]) for fold, index in chosen.items()},
            float(kept.sum() / total) if total else 0.0,
            float(held.sum() / total) if total else 0.0,
            held.sum(axis=1) / total if total else np.zeros(len(data.rois)),
            p,
            _assembled(data, own, chosen, held_out=False),
            _assembled(data, own, chosen, held_out=True),
        )
    return dict(sorted(found.items(), key=lambda item: -item[1].held_out))


def shift(data: Responses, values: np.ndarray) -> np.ndarray:
    """Standardised shifts of features: simulated less recorded.

    Parameters
    ----------
    values : ndarray, shape (..., repeats, rois, features)

    Returns
    -------
    ndarray, shape (..., rois, features)
    """
    return (values.mean(axis=-3) - data.center) / data.unit


def stand_ins(found: Mapping[Property, Trial]) -> list[Property]:
    """Properties that explain as much as the best one, within what regions differ."""
    best = next(iter(found.values()))
    rivals = []
    for one, trial in list(found.items())[1:]:
        if not trial.counts:
            continue
        difference = best.regions - trial.regions
        if np.ptp(difference) == 0 or stats.ttest_1samp(difference, 0, alternative="greater").pvalue >= AS_GOOD:
            rivals.append(one)
    return rivals


def _curves(data: Responses) -> dict[Property, dict[int, Curve]]:
    return {one: {fold: finer(one, curve) for fold, curve in own.items()} for one, own in data.curves.items()}


def _moved(data: Responses, before: np.ndarray, curves: Mapping[int, Curve]) -> dict[int, np.ndarray]:
    """What a property adds to standardised shifts, by fold: shape (strengths, rois, features)."""
    return {fold: shift(data, curve.values) - before for fold, curve in curves.items()}


def _chosen(data: Responses, before: np.ndarray, moved: Mapping[int, np.ndarray]) -> dict[int, int]:
    """Index of the strength that is fitted on each fold."""
    return {fold: _best(data, fold, before, moved[fold]) for fold in FOLDS}


def _best(data: Responses, fold: int, before: np.ndarray, moved: np.ndarray) -> int:
    """Index of the strength that removes most on a fold; the first of equal ones.

    Parameters
    ----------
    before : ndarray, shape (rois, features)
        Standardised shifts without the property.
    moved : ndarray, shape (strengths, rois, features)
        What it adds.
    """
    inside = data.fold == fold
    gains = removed(before[inside], before[inside] + moved[:, inside], data.floor[inside]).sum(axis=(1, 2))
    still = np.abs(moved).max(axis=(1, 2)) == 0
    return int(np.argmax(np.where(still, np.maximum(gains, 0), gains)))


def _assembled(data: Responses, curves: Mapping[int, Curve], chosen: Mapping[int, int], held_out: bool) -> np.ndarray:
    """Features of every ROI at the strength fitted on the other fold, or on its own.

    Parameters
    ----------
    curves : mapping of int to Curve
        By fold.
    chosen : mapping of int to int
        Index of the strength by fold.
    held_out : bool
        On the other fold.

    Returns
    -------
    ndarray, shape (repeats, rois, features)
    """
    together = np.empty_like(data.baseline)
    for fold, index in chosen.items():
        where = (data.fold == fold) != held_out
        together[:, where] = curves[fold].values[index][:, where]
    return together


def _chance(data: Responses, before: np.ndarray, moved: Mapping, seed: int) -> np.ndarray:
    """Chance of as much from a difference of no cause.

    Parameters
    ----------
    before : ndarray, shape (rois, features)
        Standardised shifts.
    moved : mapping of Property to dict of int to ndarray, shape (strengths, rois, features)
        By property and fold, what it adds.

    Returns
    -------
    ndarray, shape (properties,)
        p, corrected.
    """
    rng = generator(seed)
    # Every property weighs alike, however strong it was tried.
    ends = [np.square(own[fold][end]) for own in moved.values() for fold in FOLDS for end in (0, -1)]
    size = np.sqrt(np.mean([end / end.mean() for end in ends if end.any()], axis=0))
    pairs = zip(data.recorded, data.unit, strict=True)
    repeats = np.concatenate([(one - one.mean(axis=0)) / unit for one, unit in pairs])
    repeats /= np.sqrt((repeats**2).mean(axis=0))
    scaled = {
        one: {fold: SCALES[:, None, None] * own[fold][-1] if one.parameter is None else own[fold] for fold in FOLDS}
        for one, own in moved.items()
    }
    real = np.array([_score(data, before, own) for own in moved.values()])
    reached = np.zeros(len(moved))
    for _ in range(DRAWS):
        random = size * (rng.normal(size=len(repeats)) @ repeats) / np.sqrt(len(repeats))
        random *= np.sqrt((before**2).mean() / (random**2).mean())
        reached += np.array([_score(data, random, own) for own in scaled.values()]) >= real
    return holm((1 + reached) / (1 + DRAWS))


def _score(data: Responses, before: np.ndarray, moved: Mapping[int, np.ndarray]) -> float:
    """Share of the excess that the strengths fitted on either fold remove on the other."""
    total = weight(before, data.floor).sum()
    if not total:
        return 0.0
    gained = 0.0
    for fold in FOLDS:
        outside = data.fold != fold
        after = before[outside] + moved[fold][_best(data, fold, before, moved[fold])][outside]
        gained += removed(before[outside], after, data.floor[outside]).sum()
    return gained / total
