"""Selection of the image property that explains feature differences, tested on held-out ROIs.

The strength of each property is fitted on half of the ROIs and tested on the other half, and vice versa. Held-out
repeats would not be a test, because all repeats have the same difference.

Correlated features let a property explain part of an unrelated difference. Each property is therefore also tested on
random shifts. One random vector of features, with the feature correlation of repeats, is used for all ROIs. It is
multiplied in each ROI and feature by the typical size of property responses, and then scaled as a whole to the size of
the observed difference.
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

DRAWS = 999  # random realizations; the smallest p, before correction, is 0.001
MATERIAL = 0.1  # least share of the excess on held-out ROIs that a property must remove
AS_GOOD = 0.05  # level of the paired t-test over ROIs, above which a property is an alternative
# A property without a strength has parameters that are fitted to the recording. Its scale is fitted to random shifts.
SCALES = np.linspace(-2, 2, 17)


@dataclass(frozen=True)
class Trial:
    """Test of a property.

    Attributes
    ----------
    strengths : dict of int to float
        {fold: strength fitted on that fold}.
    fitted, held_out : float
        Removed share of the excess, on fitted and on held-out ROIs.
    regions : ndarray, shape (rois,)
        Contribution of each ROI to `held_out`.
    p : float
        Probability that random shifts are explained at least equally well, corrected over properties (Holm).
    fitted_features, held_out_features : ndarray, shape (repeats, rois, features)
        Features with the strength fitted on the ROI's fold, and on the other fold.
    """

    strengths: dict[int, float]
    fitted: float
    held_out: float
    regions: np.ndarray
    p: float
    fitted_features: np.ndarray
    held_out_features: np.ndarray

    @property
    def is_explanation(self) -> bool:
        """Whether the property explains a significant and material share."""
        return self.p < ALPHA and self.held_out >= MATERIAL


def trials(data: Responses, seed: int = 0) -> dict[Property, Trial]:
    """Test every property; the best first."""
    before = shift(data, data.baseline)
    curves = {
        changed: {fold: finer(changed, curve) for fold, curve in by_fold.items()}
        for changed, by_fold in data.curves.items()
    }
    # Changes of standardized shifts, by property and fold, shape (strengths, rois, features).
    changes = {
        changed: {fold: shift(data, curve.values) - before for fold, curve in by_fold.items()}
        for changed, by_fold in curves.items()
    }
    p_values = _p_values(data, before, changes, seed)
    total = weight(before, data.floor).sum()
    found = {}
    for (changed, by_fold), p in zip(curves.items(), p_values, strict=True):
        change = changes[changed]
        chosen = {fold: _best(data, fold, before, change[fold]) for fold in FOLDS}
        gains = {fold: removed(before, before + change[fold][index], data.floor) for fold, index in chosen.items()}
        fitted = sum(np.where((data.fold == fold)[:, None], gains[fold], 0.0) for fold in FOLDS)
        held_out = sum(np.where((data.fold != fold)[:, None], gains[fold], 0.0) for fold in FOLDS)
        found[changed] = Trial(
            {fold: float(by_fold[fold].strengths[index]) for fold, index in chosen.items()},
            float(fitted.sum() / total) if total else 0.0,
            float(held_out.sum() / total) if total else 0.0,
            held_out.sum(axis=1) / total if total else np.zeros(len(data.rois)),
            p,
            _assembled(data, by_fold, chosen, held_out=False),
            _assembled(data, by_fold, chosen, held_out=True),
        )
    return dict(sorted(found.items(), key=lambda item: -item[1].held_out))


def shift(data: Responses, values: np.ndarray) -> np.ndarray:
    """Return simulated minus recorded means in SDs of the recording's repeats, shape (..., rois, features).

    Parameters
    ----------
    values : ndarray, shape (..., repeats, rois, features)
    """
    return (values.mean(axis=-3) - data.center) / data.unit


def alternatives(found: Mapping[Property, Trial]) -> list[Property]:
    """Return the other explanations whose removed share is not significantly smaller than the best (paired t-test)."""
    best = next(iter(found.values()))
    rivals = []
    for changed, trial in list(found.items())[1:]:
        if not trial.is_explanation:
            continue
        difference = best.regions - trial.regions
        if np.ptp(difference) == 0 or stats.ttest_1samp(difference, 0, alternative="greater").pvalue >= AS_GOOD:
            rivals.append(changed)
    return rivals


def _best(data: Responses, fold: int, before: np.ndarray, change: np.ndarray) -> int:
    """Return the index of the strength that removes most on a fold; the first of equal ones.

    Parameters
    ----------
    before : ndarray, shape (rois, features)
        Standardized shifts without the property.
    change : ndarray, shape (strengths, rois, features)
        Change of the shifts by the property.
    """
    inside = data.fold == fold
    gains = removed(before[inside], before[inside] + change[:, inside], data.floor[inside]).sum(axis=(1, 2))
    neutral = np.abs(change).max(axis=(1, 2)) == 0
    return int(np.argmax(np.where(neutral, np.maximum(gains, 0), gains)))


def _assembled(data: Responses, curves: Mapping[int, Curve], chosen: Mapping[int, int], held_out: bool) -> np.ndarray:
    """Return features at the strength fitted on the other fold if `held_out`, else on the ROI's own fold.

    Parameters
    ----------
    chosen : mapping of int to int
        Index of the strength by fold.
    """
    together = np.empty_like(data.baseline)
    for fold, index in chosen.items():
        where = (data.fold == fold) != held_out
        together[:, where] = curves[fold].values[index][:, where]
    return together


def _p_values(data: Responses, before: np.ndarray, changes: Mapping, seed: int) -> np.ndarray:
    """Return corrected p-values of all properties: the share of random shifts that they explain at least equally well.

    Parameters
    ----------
    before : ndarray, shape (rois, features)
        Standardized shifts.
    changes : mapping of Property to dict of int to ndarray, shape (strengths, rois, features)
        Changes of the shifts by property and fold.
    """
    rng = generator(seed)
    # All properties have the same weight, independent of the simulated strengths.
    ends = [np.square(change[fold][end]) for change in changes.values() for fold in FOLDS for end in (0, -1)]
    size = np.sqrt(np.mean([end / end.mean() for end in ends if end.any()], axis=0))
    pairs = zip(data.recorded, data.unit, strict=True)
    repeats = np.concatenate([(values - values.mean(axis=0)) / unit for values, unit in pairs])
    repeats /= np.sqrt((repeats**2).mean(axis=0))
    scaled = [
        {fold: SCALES[:, None, None] * change[fold][-1] for fold in FOLDS} if changed.parameter is None else change
        for changed, change in changes.items()
    ]
    observed = np.array([_score(data, before, change) for change in changes.values()])
    reached = np.zeros(len(changes))
    for _ in range(DRAWS):
        random = size * (rng.normal(size=len(repeats)) @ repeats) / np.sqrt(len(repeats))
        random *= np.sqrt((before**2).mean() / (random**2).mean())
        reached += np.array([_score(data, random, change) for change in scaled]) >= observed
    return holm((1 + reached) / (1 + DRAWS))


def _score(data: Responses, before: np.ndarray, change: Mapping[int, np.ndarray]) -> float:
    """Return the share of the excess that strengths fitted on either fold remove on the other."""
    total = weight(before, data.floor).sum()
    if not total:
        return 0.0
    gained = 0.0
    for fold in FOLDS:
        outside = data.fold != fold
        after = before[outside] + change[fold][_best(data, fold, before, change[fold])][outside]
        gained += removed(before[outside], after, data.floor[outside]).sum()
    return gained / total
