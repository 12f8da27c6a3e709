"""Variance over repeated scans: noise calibration (a linear function of the noise level A), and the fixed pattern."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from . import MINIMUM_LEVELS, MINIMUM_REPEATS
from .jackknife import standard_error

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
    values = _voxels(images, union, name)
    n = len(values)
    deviation = (values - values.mean(axis=0)) ** 2
    squares = deviation.sum(axis=0)
    # Without repeat k the sum of squares of a voxel is smaller by n/(n - 1) times the squared deviation of repeat k.
    without_one = (squares - deviation * n / (n - 1)) / (n - 2)
    result = []
    for roi, mask in {**masks, EVERY_ROI: union}.items():
        inside = _inside(mask, union, roi, name)
        jackknife = without_one[:, inside].mean(axis=1)
        result.append(
            {
                "roi": roi,
                "repeats": n,
                "variance_hu2": squares[inside].mean() / (n - 1),
                "standard_error": standard_error(jackknife),
                "spatial_variance_hu2": values[:, inside].var(axis=1).mean(),
            }
        )
    return pd.DataFrame(result)


def fixed_pattern(
    images: Iterable[np.ndarray], masks: dict[str, np.ndarray], name: str = "fixed pattern"
) -> pd.DataFrame:
    """Variance of each ROI, split into the pattern that all repeats share and the noise that changes between repeats.

    The pattern contains the object's texture, and errors of sampling and reconstruction, such as streaks from few
    views. S is the variance among the voxels of one image (mean over n repeats), M the variance in the mean image.
    Their expectations are S = pattern + noise and M = pattern + noise / n, for noise of any correlation.

    Parameters
    ----------
    images, masks, name
        As for `repeat_variance`.

    Returns
    -------
    DataFrame
        One row per ROI. Columns:

        * roi, repeats
        * spatial_variance_hu2: S, with denominator n as Variance in pyradiomics
        * noise_variance_hu2: n (S - M) / (n - 1)
        * pattern_variance_hu2: (n M - S) / (n - 1); negative values are possible if there is no pattern
        * standard_error: of the pattern variance, jackknife over repeats; too large where noise dominates
        * pattern_percent: of the spatial variance; 0 for a negative pattern variance

    Raises
    ------
    InputError
        As in `repeat_variance`.
    """
    union = np.logical_or.reduce(list(masks.values()))
    values = _voxels(images, union, name)
    n = len(values)
    result = []
    for roi, mask in masks.items():
        voxels = values[:, _inside(mask, union, roi, name)]
        mean, single = voxels.mean(axis=0), voxels.var(axis=1)
        spatial, of_mean = single.mean(), mean.var()
        pattern = (n * of_mean - spatial) / (n - 1)
        without_one = ((n * mean - voxels) / (n - 1)).var(axis=1)
        jackknife = ((n - 1) * without_one - (n * spatial - single) / (n - 1)) / (n - 2)
        result.append(
            {
                "roi": roi,
                "repeats": n,
                "spatial_variance_hu2": spatial,
                "noise_variance_hu2": n * (spatial - of_mean) / (n - 1),
                "pattern_variance_hu2": pattern,
                "standard_error": standard_error(jackknife),
                "pattern_percent": 100 * max(pattern, 0.0) / spatial if spatial else 0.0,
            }
        )
    return pd.DataFrame(result)


def _voxels(images: Iterable[np.ndarray], union: np.ndarray, name: str) -> np.ndarray:
    """Voxels of the union of all ROIs in every image, float64, shape (repeats, voxels)."""
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
    return np.stack(rows)


def _inside(mask: np.ndarray, union: np.ndarray, roi: str, name: str) -> np.ndarray:
    inside = mask[union]
    if not inside.any():
        raise InputError(f"{name}: ROI {roi} is empty; draw it again")
    return inside


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
