"""Noise that was measured at three doses: what the noise calibration is drawn against.

Apart from `measured`, as every start of the workflow reads these numbers, and pandas takes a second to import.
"""

from __future__ import annotations

import csv

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..features.names import VARIANCE
from ..io.files import read_text

TABLE = RESOURCES / "edge_dose_series_summary.csv"


def dose_variance(reconstruction: str, dose_mgy: float, roi: str = "cyst_1") -> float:
    """Measured variance among the voxels of an ROI of the dose series.

    It holds the ROI's own texture and any shading beside the noise, so it bounds the noise variance from above.

    Parameters
    ----------
    reconstruction : {"fbp", "iterative"}
    dose_mgy : {1, 3, 10}
        mGy.
    roi : str, optional
        By default the large, uniform cyst.

    Returns
    -------
    float
        HU^2.

    Raises
    ------
    InputError
        If the series has no such scans.
    """
    found = [
        float(row["mean"])
        for row in csv.DictReader(read_text(TABLE, "restore it").splitlines())
        if (row["reconstruction"], float(row["dose_mgy"]), row["roi"]) == (reconstruction, dose_mgy, roi)
        and row["feature"] == VARIANCE
    ]
    if len(found) != 1:
        raise InputError(
            f"measured dose series: nothing for reconstruction {reconstruction}, {dose_mgy} mGy, ROI {roi}"
        )
    return found[0]
