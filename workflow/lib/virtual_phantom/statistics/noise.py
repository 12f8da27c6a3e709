"""Noise calibration: variance over repeated scans as a linear function of the noise level A."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from . import MINIMUM_LEVELS, MINIMUM_REPEATS

EVERY_ROI = "all ROIs"  # cannot be the name of an ROI, which has no spaces


def repeat_variance(
    images: Iterable[np.ndarray], masks: dict[str, np.ndarray], name: str = "noise calibration"
) -> pd.DataFrame:
    """Voxel-wise variance over repeats, averaged over the voxels of each ROI and of all ROIs.

    Parameters
    ----------
    images : iterable of ndarray, shape (z, y, x)
        HU, one per repeat. Only voxels of ROIs are kept in memory.
    name : str, optional
        Start of error messages.

    Returns
    -------
    DataFrame
        One row per ROI and one for their union (roi EVERY_ROI). Columns:

        * roi, repeats
        * variance_hu2: unbiased (denominator n - 1)
        * standard_error: jackknife over repeats, because noise is correlated between voxels
        * spatial_variance_hu2: variance among the voxels of one image (denominator n, as Variance in pyradiomics), mean
          over repeats; it includes noise and structure of the object

    Raises
    ------
    InputError
        For fewer than three repeats, an image of another shape, an empty ROI, or values that are not finite.
    """
    union = np.logical_or.reduce(list(masks.values()))
    rows = []
    for index, image in enumerate(images):
        if image.shape != union.shape:
            raise InputError(
                f"{name}: repeat {index + 1} has shape {image.shape}, the ROI masks {union.shape}; reconstruct it again"
            )
        voxels = image[union].astype(np.float64)
        if not np.isfinite(voxels).all():
            raise InputError(
                f"{name}: repeat {index + 1} has voxels that are not finite inside an ROI; reconstruct it again"
            )
        rows.append(voxels)
    if len(rows) < MINIMUM_REPEATS:
        raise InputError(f"{name}: {len(rows)} repeats; a variance and its error need at least {MINIMUM_REPEATS}")
    values = np.stack(rows)
    n = len(values)
    deviation = (values - values.mean(axis=0)) ** 2
    squares = deviation.sum(axis=0)
    # Without repeat k the sum of squares of a voxel is smaller by n/(n - 1) times the squared deviation of repeat k.
    without_one = (squares - deviation * n / (n - 1)) / (n - 2)
    result = []
    for roi, mask in {**masks, EVERY_ROI: union}.items():
        inside = mask[union]
        if not inside.any():
            raise InputError(f"{name}: ROI {roi} is empty; draw it again")
        jackknife = without_one[:, inside].mean(axis=1)
        error = np.sqrt((n - 1) / n * ((jackknife - jackknife.mean()) ** 2).sum())
        result.append(
            {
                "roi": roi,
                "repeats": n,
                "variance_hu2": squares[inside].mean() / (n - 1),
                "standard_error": error,
                "spatial_variance_hu2": values[:, inside].var(axis=1).mean(),
            }
        )
    return pd.DataFrame(result)


@dataclass(frozen=True)
class LinearFit:
    """Least-squares line: variance = intercept + slope * noise level."""

    slope: float
    intercept: float
    r_squared: float

    def noise_level_for(self, variance: float) -> float:
        """Return the noise level at which the line reaches a variance (HU^2); InputError if it is not positive."""
        level = (variance - self.intercept) / self.slope if self.slope > 0 else float("nan")
        if not level > 0:
            raise InputError(
                f"noise calibration: no positive noise level gives a variance of {variance:g} HU^2 on the "
                f"line {self.intercept:g} + {self.slope:g} A"
            )
        return level


def linear_fit(noise_level: np.ndarray, variance: np.ndarray) -> LinearFit:
    """Fit a line to variance (HU^2) against noise level A; InputError for fewer than two different levels."""
    noise_level = np.asarray(noise_level, dtype=np.float64)
    if np.unique(noise_level).size < 2:
        raise InputError("noise calibration: a line needs at least two different noise levels")
    line = scipy.stats.linregress(noise_level, np.asarray(variance, dtype=np.float64))
    return LinearFit(slope=float(line.slope), intercept=float(line.intercept), r_squared=float(line.rvalue**2))


@dataclass(frozen=True)
class NoiseMatch:
    """Noise level at which a protocol has a measured variance.

    Attributes
    ----------
    A, A_standard_error : float
        Noise level and its error from the fit and the measurement.
    extrapolated : bool
        Whether A lies outside the simulated levels.
    """

    A: float
    A_standard_error: float
    variance_hu2: float
    extrapolated: bool


def match_noise_level(calibration: pd.DataFrame, protocol: str, rois: list[str], measured: pd.DataFrame) -> NoiseMatch:
    """Return the noise level A at which the mean variance within ROIs equals the variance in a recording.

    The line is fitted by weighted least squares. The standard error combines the error of inverse prediction from a
    calibration line [1]_ and the error of the recording over its repeats.

    Parameters
    ----------
    calibration : DataFrame
        Columns protocol, noise_level, roi, spatial_variance_hu2, with at least three levels.
    measured : DataFrame
        Variance (HU^2) of each ROI (columns) in each recorded repeat (rows).

    Raises
    ------
    InputError
        For an unknown protocol or ROI, fewer than three levels, or a variance that no A reaches.

    References
    ----------
    .. [1] N. R. Draper and H. Smith, Applied Regression Analysis, 3rd ed., 1998, section 3.2.
    """
    rows = calibration[calibration["protocol"] == protocol]
    if rows.empty:
        raise InputError(f"noise calibration: no rows of protocol {protocol}; add it to analyses.noise_calibration")
    for roi in rois:
        for source, known in (("noise calibration", set(rows["roi"])), ("recording", set(measured.columns))):
            if roi not in known:
                raise InputError(f"{source}: has no ROI {roi}; choose from {', '.join(sorted(known))}")
    levels = rows[rows["roi"].isin(rois)].groupby("noise_level")["spatial_variance_hu2"].mean()
    x, y = levels.index.to_numpy(dtype=np.float64), levels.to_numpy()
    if len(x) < MINIMUM_LEVELS:
        raise InputError(
            f"noise calibration: {len(x)} noise levels of {protocol}; a line and its error need {MINIMUM_LEVELS}"
        )
    repeats = measured[list(rois)].dropna().mean(axis=1).to_numpy(dtype=np.float64)
    if not len(repeats):
        raise InputError(f"recording: no repeat has all of the ROIs {', '.join(rois)}; name ROIs that one has")
    target = float(repeats.mean())
    # The error of a variance is proportional to the variance, hence the weights 1 / y.
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=1 / y, cov=True)
    level = LinearFit(slope, intercept, np.nan).noise_level_for(target)
    line_variance = np.array([level, 1]) @ covariance @ np.array([level, 1])
    recording_variance = repeats.var(ddof=1) / len(repeats) if len(repeats) > 1 else 0.0
    error = float(np.sqrt(line_variance + recording_variance) / slope)
    return NoiseMatch(float(level), error, target, not x.min() <= level <= x.max())
