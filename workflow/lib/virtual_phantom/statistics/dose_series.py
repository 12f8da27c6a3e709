"""Noise variance measured at three doses, shown as a reference in the noise calibration.

The module is separate from `measured`, because every start of the workflow reads these numbers and pandas takes a
second to import.
"""

from __future__ import annotations

import csv

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..features.names import VARIANCE
from ..io.files import read_text

TABLE = RESOURCES / "edge_dose_series_summary.csv"
MEASURED_ROI = "cyst_1"  # the large cyst, which is uniform in the drawn phantom


def dose_variance(reconstruction: str, dose_mgy: float) -> float:
    """Variance (HU^2) among the voxels of MEASURED_ROI in the measured dose series.

    The variance includes texture and shading of the ROI, so it is an upper bound of the noise variance.

    Parameters
    ----------
    reconstruction : {"fbp", "iterative"}
    dose_mgy : {1, 3, 10}

    Raises
    ------
    InputError
        If the series has no such scans.
    """
    found = [
        float(row["mean"])
        for row in csv.DictReader(read_text(TABLE, "restore it").splitlines())
        if (row["reconstruction"], float(row["dose_mgy"]), row["roi"]) == (reconstruction, dose_mgy, MEASURED_ROI)
        and row["feature"] == VARIANCE
    ]
    if len(found) != 1:
        raise InputError(
            f"measured dose series: no value for reconstruction {reconstruction}, {dose_mgy} mGy, ROI {MEASURED_ROI}; "
            "use fbp or iterative, and 1, 3 or 10 mGy"
        )
    return found[0]
