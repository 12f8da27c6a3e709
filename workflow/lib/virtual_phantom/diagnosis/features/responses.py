"""Responses of features to image properties, and the share of a recording's shifts that they remove."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from ...base.errors import InputError
from ...base.geometry import Grid
from ...features.settings import STUDY, Extraction, other_settings
from ...statistics.comparability import SAME_VOXELS, comparable, roi_sizes
from ...statistics.comparison import common_features, common_rois, samples, spread
from .properties import BASELINE, EVERY_FOLD, FOLDS, Property, folds, properties

STEPS = 4  # interpolated steps between two simulated strengths
SOFT = 4.0  # excess over the floor, as a ratio, from which a cell has full weight: a shift of 2.2 standard errors


@dataclass(frozen=True)
class Curve:
    """Features at the strengths of a property.

    Attributes
    ----------
    strengths : ndarray, shape (strengths,)
        Ascending.
    values : ndarray, shape (strengths, repeats, rois, features)
    """

    strengths: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Responses:
    """Simulated and recorded features.

    Attributes
    ----------
    classes : dict of str to str
        Tissue class by ROI.
    fold : ndarray of int, shape (rois,)
    recorded : list of ndarray, shape (repeats, features)
        One per ROI.
    baseline : ndarray, shape (repeats, rois, features)
    curves : dict of Property to dict of int to Curve
        {property: {fold: Curve}}, with the baseline at the neutral strength.
    """

    rois: list[str]
    features: list[str]
    classes: dict[str, str]
    fold: np.ndarray
    recorded: list[np.ndarray]
    baseline: np.ndarray
    curves: dict[Property, dict[int, Curve]]

    @cached_property
    def unit(self) -> np.ndarray:
        """SD over the repeats of the recording, shape (rois, features)."""
        return np.stack([spread(repeats) for repeats in self.recorded])

    @cached_property
    def center(self) -> np.ndarray:
        """Recorded means, shape (rois, features)."""
        return np.stack([repeats.mean(axis=0) for repeats in self.recorded])

    @cached_property
    def floor(self) -> np.ndarray:
        """Expected squared standardized shift by noise alone, shape (rois, features)."""
        count = np.array([len(repeats) for repeats in self.recorded])[:, None]
        return 1 / count + self.baseline.var(axis=0, ddof=1) / self.unit**2 / len(self.baseline)


def compared(
    table: pd.DataFrame, recorded: pd.DataFrame, dimensions: int, stored_offset_hu: float, study: Extraction = STUDY
) -> tuple[list[str], dict[str, str]]:
    """Return the comparable features, and {feature: reason} for the others.

    Features that depend on the size of the ROI are comparable only if each ROI has the same number of voxels in both
    tables. Features with other extraction settings than the study are not comparable.

    Parameters
    ----------
    dimensions, stored_offset_hu
        See comparability.comparable.
    study : Extraction, optional
        Extraction settings of `table`.

    Raises
    ------
    InputError
        If no feature is comparable.
    """
    baseline = table[table["property"] == BASELINE]
    features = common_features(baseline, recorded)
    simulated_sizes, recorded_sizes = (roi_sizes(rows).set_index("roi") for rows in (baseline, recorded))
    ratio = (simulated_sizes["n_voxels"] / recorded_sizes["n_voxels"]).dropna()
    same = bool((np.abs(ratio - 1) < SAME_VOXELS).all())
    other = other_settings(features, recorded, study)
    verdicts = comparable(features, dimensions, stored_offset_hu, same_voxels=same, other_settings=other)
    refused = verdicts[verdicts["comparable"] == "no"].set_index("feature")
    if len(refused) == len(features):
        raise InputError(f"recording: none of its features can be compared: {refused['reason'].iloc[0]}")
    return [feature for feature in features if feature not in refused.index], dict(refused["reason"])


def responses(
    table: pd.DataFrame, recorded: pd.DataFrame, features: Sequence[str], grid: Grid, rois: Sequence[str] | None = None
) -> Responses:
    """Arrange the tables of `changes.property_tables` by property.

    Parameters
    ----------
    table : DataFrame
        Tables with a column tissue_class.
    features : sequence of str
        Features to compare. Features that are constant over the repeats of an ROI have no unit and are omitted.
    grid : Grid
        Grid of the simulated images.
    rois : sequence of str, optional
        See comparison.common_rois.

    Raises
    ------
    InputError
        If comparison.samples raises it, or if every feature is constant.
    """
    baseline = table[table["property"] == BASELINE]
    rois = common_rois(baseline, recorded, rois)
    repeats = samples(recorded, features, rois, "recorded features")
    varies = np.all([spread(repeats[roi]) > 0 for roi in rois], axis=0)
    features = [feature for feature, kept in zip(features, varies, strict=True) if kept]
    if not features:
        raise InputError("diagnosis: no feature of the recording varies over its repeats; give it repeats that differ")

    def array(part):
        found = samples(part, features, rois, f"features of {part['property'].iloc[0]}")
        return np.stack([found[roi] for roi in rois], axis=1)

    plain = array(baseline)
    class_of = dict(baseline.drop_duplicates("roi").set_index("roi")["tissue_class"])
    classes = {roi: str(class_of[roi]) for roi in rois}
    fold_of = folds(classes)
    curves: dict[Property, dict[int, Curve]] = {}
    for changed in properties():
        simulated = table[table["property"] == changed.name]
        if simulated.empty:
            continue
        curves[changed] = {}
        for fold in FOLDS:
            part = simulated[simulated["fold"].isin((EVERY_FOLD, fold))]
            nodes = {strength: array(rows) for strength, rows in part.groupby("strength")}
            nodes[changed.neutral(grid)] = plain
            strengths = np.array(sorted(nodes))
            curves[changed][fold] = Curve(strengths, np.stack([nodes[strength] for strength in strengths]))
    return Responses(
        rois,
        features,
        classes,
        np.array([fold_of[roi] for roi in rois]),
        [repeats[roi][:, varies] for roi in rois],
        plain,
        curves,
    )


def finer(changed: Property, curve: Curve) -> Curve:
    """Interpolate a curve between its strengths, linearly in the axis of the property.

    The curve of a property without a strength is returned as is.
    """
    if changed.parameter is None:
        return curve
    function, inverse = changed.axis
    at = function(curve.strengths)
    fine = np.concatenate(
        [np.linspace(a, b, STEPS, endpoint=False) for a, b in zip(at[:-1], at[1:], strict=True)] + [at[-1:]]
    )
    low = np.clip(np.searchsorted(at, fine, side="right") - 1, 0, len(at) - 2)
    part = ((fine - at[low]) / (at[low + 1] - at[low]))[:, None, None, None]
    return Curve(inverse(fine), (1 - part) * curve.values[low] + part * curve.values[low + 1])


def excess(shift: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return the squared standardized shift beyond the floor."""
    return np.maximum(shift**2 - floor, 0.0)


def weight(before: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return the weight of every cell: 1 for a certain difference, 0 at the floor."""
    beyond = excess(before, floor)
    return beyond / np.maximum(beyond, SOFT * floor)


def removed(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return the share of the excess that is removed from every cell, from -1 (new excess) to 1 (all removed).

    An excess below SOFT times the floor counts less, and no cell counts more than 1. In sums of squares, a few features
    with little noise would dominate.

    Parameters
    ----------
    before, after, floor : ndarray
        Standardized shifts, and their expected square by noise alone.
    """
    first, last = excess(before, floor), excess(after, floor)
    return (first - last) / np.maximum(np.maximum(first, last), SOFT * floor)
