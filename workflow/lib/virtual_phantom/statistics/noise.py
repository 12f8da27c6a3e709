"""Noise calibration: variance over repeated scans against the noise level A, and the line through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import linregress

from ..errors import InputError
from . import MINIMUM_REPEATS


def repeat_variance(
    images: Iterable[np.ndarray], masks: dict[str, np.ndarray], name: str = "noise calibration"
) -> pd.DataFrame:
    """Voxel-wise variance over repeats of a scan, averaged over the voxels of each ROI, and of all ROIs
    together.

    images   arrays [z, y, x] in HU, one per repeat; looked at one at a time, and only the ROIs' voxels are
             kept
    masks    boolean arrays [z, y, x] by ROI
    Returns one row per ROI and one for "all" (the union of the ROIs): roi, repeats, variance_hu2 (n - 1 in
    the denominator, so unbiased), standard_error (jackknife over repeats: neighbouring voxels share noise and
    cannot be counted as independent).
    Raises InputError for fewer than three repeats, another shape, an empty ROI or values that are not finite.
    """
    union = np.logical_or.reduce(list(masks.values()))
    rows = []
    for index, image in enumerate(images):
        if image.shape != union.shape:
            raise InputError(f"{name}: repeat {index + 1} has shape {image.shape}, the ROI masks {union.shape}")
        voxels = image[union].astype(np.float64)
        if not np.isfinite(voxels).all():
            raise InputError(f"{name}: repeat {index + 1} has voxels that are not finite inside an ROI")
        rows.append(voxels)
    if len(rows) < MINIMUM_REPEATS:
        raise InputError(f"{name}: {len(rows)} repeats; at least {MINIMUM_REPEATS} give a variance and its error")
    values = np.stack(rows)
    n = len(values)
    deviation = (values - values.mean(axis=0)) ** 2
    squares = deviation.sum(axis=0)
    # Leaving repeat k out lowers a voxel's sum of squares by n/(n - 1) times its squared deviation.
    left_out = (squares - deviation * n / (n - 1)) / (n - 2)
    result = []
    for roi, mask in {**masks, "all": union}.items():
        inside = mask[union]
        if not inside.any():
            raise InputError(f"{name}: ROI {roi} is empty")
        jackknife = left_out[:, inside].mean(axis=1)
        error = np.sqrt((n - 1) / n * ((jackknife - jackknife.mean()) ** 2).sum())
        result.append(
            {
                "roi": roi,
                "repeats": n,
                "variance_hu2": squares[inside].mean() / (n - 1),
                "standard_error": error,
            }
        )
    return pd.DataFrame(result)


@dataclass(frozen=True)
class LinearFit:
    """variance = intercept + slope * noise level, by least squares."""

    slope: float
    intercept: float
    r_squared: float

    def noise_level_for(self, variance: float) -> float:
        """The noise level at which the line reaches a variance. InputError if no positive level does."""
        level = (variance - self.intercept) / self.slope if self.slope > 0 else float("nan")
        if not level > 0:
            raise InputError(
                f"noise calibration: no positive noise level gives a variance of {variance:g} HU^2 on the "
                f"line {self.intercept:g} + {self.slope:g} A"
            )
        return level


def linear_fit(noise_level: np.ndarray, variance: np.ndarray) -> LinearFit:
    """Straight line of variance (HU^2) against noise level A. Raises InputError for fewer than two different
    levels."""
    noise_level = np.asarray(noise_level, dtype=np.float64)
    if np.unique(noise_level).size < 2:
        raise InputError("noise calibration: a line needs at least two different noise levels")
    line = linregress(noise_level, np.asarray(variance, dtype=np.float64))
    return LinearFit(slope=float(line.slope), intercept=float(line.intercept), r_squared=float(line.rvalue**2))
