"""Features of stored values, which scanners keep as HU + 1024, brought to HU."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..base.errors import InputError

STORED_OFFSET_HU = 1024  # of the published tables over HU: their scans store HU + 1024


def to_hu(table: pd.DataFrame, offset_hu: float = STORED_OFFSET_HU) -> pd.DataFrame:
    """First-order features in HU instead of stored values.

    Means and quantiles shift; energy is N (variance + mean^2), the mean now in HU and N the stored energy over the
    square of the stored root mean square; RootMeanSquared is the root of the same without N, and TotalEnergy keeps its
    ratio to energy. Spreads stay. Histograms and textures cannot be converted: 1024 is not a whole number of bins of
    25, so bin edges lie one unit off those of values in HU.

    Parameters
    ----------
    table : DataFrame
        Features that it lacks are passed over.
    offset_hu : float, optional
        Stored values are HU + this; by default those of `load_full_table`.

    Raises
    ------
    InputError
        If the table has an energy or root mean square without what their conversion needs.
    """
    if offset_hu == 0:
        return table
    table = table.copy()
    name = "original_firstorder_{}".format
    for feature in map(name, ("10Percentile", "90Percentile", "Maximum", "Mean", "Median", "Minimum")):
        if feature in table:
            table[feature] -= offset_hu
    square_root, energy, total = map(name, ("RootMeanSquared", "Energy", "TotalEnergy"))
    # Of the energies, the stored root mean square tells the number of voxels.
    needed = {square_root: ("Mean", "Variance"), energy: ("Mean", "Variance", "RootMeanSquared")}
    needed[total] = needed[energy]
    for feature, others in needed.items():
        if feature in table and (missing := [other for other in map(name, others) if other not in table]):
            raise InputError(
                f"features: {feature} is of stored values (HU + {offset_hu:g}) and cannot be brought to HU without "
                f"{missing[0]}; leave it out"
            )
    if square_root not in table:
        return table
    square = table[name("Variance")] + table[name("Mean")] ** 2
    change = square / table[square_root] ** 2
    for feature in (energy, total):
        if feature in table:
            table[feature] *= change
    table[square_root] = np.sqrt(square)
    return table
