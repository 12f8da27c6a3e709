"""Agreement of feature values over ROIs between simulation and measurement.

A ranking of features by stability depends mostly on their definitions: white noise on the phantom gives nearly the same
ranking. The values of a feature over ROIs depend on the object and the scan.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..base.errors import InputError


def compare_profiles(simulated: pd.DataFrame, measured: pd.DataFrame) -> pd.DataFrame:
    """Compare two tables of features (columns) by ROI (rows), for every feature that both have.

    Returns
    -------
    DataFrame
        Columns:

        * feature
        * order: Spearman's coefficient over ROIs; 0 where a feature is constant over ROIs in one of the sets
        * distance: median over ROIs of |simulated - measured|, in SDs of the measured values between ROIs; infinite
          where these do not vary

    Raises
    ------
    InputError
        If the sets share fewer than three ROIs, or no feature.
    """
    rois = [roi for roi in measured.index if roi in simulated.index]
    features = [feature for feature in measured.columns if feature in simulated.columns]
    if len(rois) < 3 or not features:
        raise InputError(
            f"profiles over ROIs: {len(rois)} ROIs and {len(features)} features in common; at least 3 and 1 are needed"
        )
    simulated, measured = simulated.loc[rois, features], measured.loc[rois, features]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((simulated - measured).abs() / measured.std(ddof=1)).median()
    order = simulated.rank().corrwith(measured.rank()).fillna(0)
    return pd.DataFrame({"feature": features, "order": order.to_numpy(), "distance": distance.to_numpy()})
