"""Convert first-order features of stored values (HU plus an offset) to HU."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..base.errors import InputError

STORED_OFFSET_HU = 1024  # offset of the published tables, whose scans store HU + 1024


def convert_to_hu(table: pd.DataFrame, offset_hu: float = STORED_OFFSET_HU) -> pd.DataFrame:
    """Convert first-order features of HU + offset_hu to HU.

    Means and quantiles shift. Measures of spread do not change. RootMeanSquared becomes sqrt(variance + mean^2), with
    the mean in HU. Energy and TotalEnergy are multiplied by (new RootMeanSquared / old RootMeanSquared)^2. Entropy,
    Uniformity and texture features cannot be converted: 1024 is not a multiple of the bin width 25, so bin edges differ
    by one unit.

    Parameters
    ----------
    table : DataFrame
        Features may be missing.

    Raises
    ------
    InputError
        If the table lacks a feature that the conversion of Energy, TotalEnergy or RootMeanSquared needs.
    """
    if offset_hu == 0:
        return table
    table = table.copy()
    full_name = "original_firstorder_{}".format
    for feature in map(full_name, ("10Percentile", "90Percentile", "Maximum", "Mean", "Median", "Minimum")):
        if feature in table:
            table[feature] -= offset_hu
    rms, energy, total = map(full_name, ("RootMeanSquared", "Energy", "TotalEnergy"))
    # The factor of Energy and TotalEnergy contains the old RootMeanSquared, so the table must have it.
    needed = {rms: ("Mean", "Variance"), energy: ("Mean", "Variance", "RootMeanSquared")}
    needed[total] = needed[energy]
    for feature, others in needed.items():
        if feature in table and (missing := [other for other in map(full_name, others) if other not in table]):
            raise InputError(
                f"features: {feature} is of stored values (HU + {offset_hu:g}) and cannot be converted to HU without "
                f"{missing[0]}; remove the column"
            )
    if rms not in table:
        return table
    square = table[full_name("Variance")] + table[full_name("Mean")] ** 2
    change = square / table[rms] ** 2
    for feature in (energy, total):
        if feature in table:
            table[feature] *= change
    table[rms] = np.sqrt(square)
    return table
