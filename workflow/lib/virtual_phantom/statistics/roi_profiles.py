"""Values of features over ROIs in simulation and measurement: what rankings of features do not show.

A ranking says which features are stable, and most of that follows from how features are defined: white noise on the
phantom gives nearly the same one. What a feature says of six ROIs, one beside the other, depends on what was scanned
and how.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError

ALIKE = 0.9  # Spearman's coefficient; of six ROIs, at most two neighbours in order are swapped (0.94)


def profiles(table: pd.DataFrame, features: Sequence[str]) -> pd.DataFrame:
    """Mean over repeats of every feature (columns) in every ROI (rows, by name)."""
    return table.groupby("roi")[list(features)].mean()


def compare(simulated: pd.DataFrame, measured: pd.DataFrame) -> pd.DataFrame:
    """How alike two sets of `profiles` are, for every feature that both have.

    Returns
    -------
    DataFrame
        Columns feature, order (Spearman's coefficient over ROIs; 0 where a feature does not tell ROIs apart in one of
        the two) and distance (median over ROIs of |simulated - measured|, in SDs of the measured values between ROIs;
        infinite where these do not vary).

    Raises
    ------
    InputError
        If they share fewer than three ROIs, or no feature.
    """
    rois = [roi for roi in measured.index if roi in simulated.index]
    features = [feature for feature in measured.columns if feature in simulated.columns]
    if len(rois) < 3 or not features:
        raise InputError(f"profiles over ROIs: {len(rois)} ROIs and {len(features)} features in common; needs 3 and 1")
    simulated, measured = simulated.loc[rois, features], measured.loc[rois, features]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((simulated - measured).abs() / measured.std(ddof=1)).median()
    order = simulated.rank().corrwith(measured.rank()).fillna(0)
    return pd.DataFrame({"feature": features, "order": order.to_numpy(), "distance": distance.to_numpy()})


def agreement(found: pd.DataFrame) -> dict[str, float]:
    """Over the features of `compare`: mean order, percentage with at least ALIKE, median distance."""
    return {
        "order": float(found["order"].mean()),
        "alike_percent": float(100 * (found["order"] >= ALIKE).mean()),
        "distance": float(found["distance"].median()),
    }
