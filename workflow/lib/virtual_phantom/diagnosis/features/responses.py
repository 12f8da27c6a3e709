"""What every property does to every feature, and how much of a recording's shifts it removes."""

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

STEPS = 4  # strengths tried between two that were simulated
SOFT = 4.0  # times the floor: a cell counts in full from two standard errors on


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
    """Simulated and recorded features side by side.

    Attributes
    ----------
    rois, features : list of str
        Names.
    classes : dict of str to str
        The tissue class of every ROI.
    fold : ndarray of int, shape (rois,)
    recorded : list of ndarray, shape (repeats, features)
        Of every ROI.
    baseline : ndarray, shape (repeats, rois, features)
    curves : dict of Property to dict of int to Curve
        {property: {fold: Curve}}, the baseline at the neutral strength among them.
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
        """SD over the recording's repeats, shape (rois, features)."""
        return np.stack([spread(one) for one in self.recorded])

    @cached_property
    def center(self) -> np.ndarray:
        """Recorded means, shape (rois, features)."""
        return np.stack([one.mean(axis=0) for one in self.recorded])

    @cached_property
    def floor(self) -> np.ndarray:
        """Square of the standardised shift that noise alone gives, shape (rois, features)."""
        count = np.array([len(one) for one in self.recorded])[:, None]
        return 1 / count + self.baseline.var(axis=0, ddof=1) / self.unit**2 / len(self.baseline)


def compared(
    table: pd.DataFrame, recorded: pd.DataFrame, dimensions: int, stored_offset_hu: float, study: Extraction = STUDY
) -> tuple[list[str], dict[str, str]]:
    """Features of `property_tables` and a recording that tell of the images.

    What grows with the ROI is kept only if ROIs have the same voxels, as the features themselves tell. What was
    extracted with other settings than the study's is not kept.

    Parameters
    ----------
    dimensions : {2, 3}
    stored_offset_hu : float
        Both of the recording's features, as comparability.comparable takes them.
    study : Extraction, optional
        How features of `table` were extracted.

    Returns
    -------
    left_out : dict of str to str
        {feature: why}.

    Raises
    ------
    InputError
        If nothing is left.
    """
    baseline = table[table["property"] == BASELINE]
    features = common_features(baseline, recorded)
    ours, theirs = (roi_sizes(one).set_index("roi") for one in (baseline, recorded))
    ratio = (ours["n_voxels"] / theirs["n_voxels"]).dropna()
    same = bool((np.abs(ratio - 1) < SAME_VOXELS).all())
    other = other_settings(features, recorded, study)
    verdicts = comparable(features, dimensions, stored_offset_hu, same_voxels=same, other_settings=other)
    refused = verdicts[verdicts["comparable"] == "no"].set_index("feature")
    if len(refused) == len(features):
        raise InputError(f"recording: none of its features can be compared: {refused['reason'].iloc[0]}")
    return [one for one in features if one not in refused.index], dict(refused["reason"])


def responses(
    table: pd.DataFrame, recorded: pd.DataFrame, features: Sequence[str], grid: Grid, rois: Sequence[str] | None = None
) -> Responses:
    """Order the tables of `property_tables` by property.

    Parameters
    ----------
    table : DataFrame
        With a column tissue_class.
    features : sequence of str
        Those to compare; what does not vary in the recording, in any ROI, has no unit and is left out.
    grid : Grid
        Of the simulated images.
    rois : sequence of str, optional
        As comparison.common_rois takes them.

    Raises
    ------
    InputError
        For what comparison.samples refuses, and if no feature is left.
    """
    baseline = table[table["property"] == BASELINE]
    rois = common_rois(baseline, recorded, rois)
    theirs = samples(recorded, features, rois, "recorded features")
    varies = np.all([spread(theirs[roi]) > 0 for roi in rois], axis=0)
    features = [feature for feature, one in zip(features, varies, strict=True) if one]
    if not features:
        raise InputError("diagnosis: no feature of the recording varies over its repeats; give it repeats that differ")

    def array(part):
        found = samples(part, features, rois, f"features of {part['property'].iloc[0]}")
        return np.stack([found[roi] for roi in rois], axis=1)

    plain = array(baseline)
    classes = dict(baseline.drop_duplicates("roi").set_index("roi")["tissue_class"])
    fold_of = folds({roi: str(classes[roi]) for roi in rois})
    curves: dict[Property, dict[int, Curve]] = {}
    for one in properties():
        own = table[table["property"] == one.name]
        if own.empty:
            continue
        curves[one] = {}
        for fold in FOLDS:
            part = own[own["fold"].isin((EVERY_FOLD, fold))]
            nodes = {strength: array(rows) for strength, rows in part.groupby("strength")}
            nodes[one.neutral(grid)] = plain
            strengths = np.array(sorted(nodes))
            curves[one][fold] = Curve(strengths, np.stack([nodes[strength] for strength in strengths]))
    return Responses(
        rois,
        features,
        {roi: str(classes[roi]) for roi in rois},
        np.array([fold_of[roi] for roi in rois]),
        [theirs[roi][:, varies] for roi in rois],
        plain,
        curves,
    )


def finer(one: Property, curve: Curve) -> Curve:
    """A curve with steps between its strengths, features linear in the property's axis.

    A property without a strength is there or not and stays as it is.
    """
    if one.parameter is None:
        return curve
    function, inverse = one.axis
    at = function(curve.strengths)
    fine = np.concatenate(
        [np.linspace(a, b, STEPS, endpoint=False) for a, b in zip(at[:-1], at[1:], strict=True)] + [at[-1:]]
    )
    low = np.clip(np.searchsorted(at, fine, side="right") - 1, 0, len(at) - 2)
    part = ((fine - at[low]) / (at[low + 1] - at[low]))[:, None, None, None]
    return Curve(inverse(fine), (1 - part) * curve.values[low] + part * curve.values[low + 1])


def excess(shift: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Squared standardised shift beyond the floor."""
    return np.maximum(shift**2 - floor, 0.0)


def weight(before: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """How much every cell counts: 1 where it differs beyond doubt, 0 at the floor."""
    there = excess(before, floor)
    return there / np.maximum(there, SOFT * floor)


def removed(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Share of its excess that every cell loses.

    Cells count alike: of sums of squares, a few features that noise hardly moves would be nearly all.

    Parameters
    ----------
    before, after, floor : ndarray
        Standardised shifts, and the square of what noise alone gives.

    Returns
    -------
    ndarray
        From -1 (new or many times larger) to 1 (gone).
    """
    first, last = excess(before, floor), excess(after, floor)
    return (first - last) / np.maximum(np.maximum(first, last), SOFT * floor)
