"""Noise calibration: variance over repeated scans against the noise level A, and the line through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy

from ..base.errors import InputError
from . import MINIMUM_LEVELS, MINIMUM_REPEATS

EVERY_ROI = "all ROIs"  # names of ROIs have no spaces, so that none is equal to it


def repeat_variance(
    images: Iterable[np.ndarray], masks: dict[str, np.ndarray], name: str = "noise calibration"
) -> pd.DataFrame:
    """Voxel-wise variance over repeats of a scan, averaged over the voxels of each ROI, and of all ROIs together.

    Parameters
    ----------
    images : iterable of ndarray, shape (z, y, x)
        HU, one per repeat; looked at one at a time, and only the ROIs' voxels are kept.
    masks : dict of str to ndarray of bool, shape (z, y, x)
        By ROI.
    name : str, optional
        What the message begins with.

    Returns
    -------
    DataFrame
        One row per ROI and one for their union, whose roi is EVERY_ROI. Columns: roi, repeats, variance_hu2 (n - 1 in
        the denominator, so unbiased), standard_error (jackknife over repeats: neighboring voxels share noise and cannot
        be counted as independent), spatial_variance_hu2 (among the voxels of one image, n in the denominator, as
        pyradiomics' Variance: noise and variation of the object; mean over repeats).

    Raises
    ------
    InputError
        For fewer than three repeats, another shape, an empty ROI or values that are not finite.
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
    for roi, mask in {**masks, EVERY_ROI: union}.items():
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
                "spatial_variance_hu2": values[:, inside].var(axis=1).mean(),
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
        """The noise level at which the line reaches a variance, HU^2.

        Raises
        ------
        InputError
            If no positive level does.
        """
        level = (variance - self.intercept) / self.slope if self.slope > 0 else float("nan")
        if not level > 0:
            raise InputError(
                f"noise calibration: no positive noise level gives a variance of {variance:g} HU^2 on the "
                f"line {self.intercept:g} + {self.slope:g} A"
            )
        return level


def linear_fit(noise_level: np.ndarray, variance: np.ndarray) -> LinearFit:
    """Straight line of variance (HU^2) against noise level A.

    Raises
    ------
    InputError
        For fewer than two different levels.
    """
    noise_level = np.asarray(noise_level, dtype=np.float64)
    if np.unique(noise_level).size < 2:
        raise InputError("noise calibration: a line needs at least two different noise levels")
    line = scipy.stats.linregress(noise_level, np.asarray(variance, dtype=np.float64))
    return LinearFit(slope=float(line.slope), intercept=float(line.intercept), r_squared=float(line.rvalue**2))


@dataclass(frozen=True)
class Match:
    """The noise level at which a protocol shows a measured variance.

    Attributes
    ----------
    A, A_standard_error : float
        Noise level and the error of it that the fit and the measurement leave.
    variance_hu2 : float
        What was measured, HU^2.
    extrapolated : bool
        True if A lies outside the simulated levels.
    """

    A: float
    A_standard_error: float
    variance_hu2: float
    extrapolated: bool


def match(calibration: pd.DataFrame, protocol: str, rois: list[str], measured: pd.DataFrame) -> Match:
    """The A at which the variance within ROIs, averaged over them, meets a recording's.

    The line is fitted by weighted least squares. Standard error: that of a calibration line read backwards [1]_, with
    the recording's own over its repeats.

    Parameters
    ----------
    calibration : DataFrame
        Columns protocol, noise_level, roi, spatial_variance_hu2, of at least three levels.
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
        for what, known in (("noise calibration", set(rows["roi"])), ("recording", set(measured.columns))):
            if roi not in known:
                raise InputError(f"{what}: has no ROI {roi}; there are {', '.join(sorted(known))}")
    levels = rows[rows["roi"].isin(rois)].groupby("noise_level")["spatial_variance_hu2"].mean()
    x, y = levels.index.to_numpy(dtype=np.float64), levels.to_numpy()
    if len(x) < MINIMUM_LEVELS:
        raise InputError(
            f"noise calibration: {len(x)} noise levels of {protocol}; {MINIMUM_LEVELS} give a line and its error"
        )
    repeats = measured[list(rois)].dropna().mean(axis=1).to_numpy(dtype=np.float64)
    if not len(repeats):
        raise InputError(f"recording: no repeat has all of the ROIs {', '.join(rois)}")
    target = float(repeats.mean())
    # The error of a variance is in proportion to it, so each point weighs by its own.
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=1 / y, cov=True)
    level = LinearFit(slope, intercept, np.nan).noise_level_for(target)
    of_line = np.array([level, 1]) @ covariance @ np.array([level, 1])
    of_recording = repeats.var(ddof=1) / len(repeats) if len(repeats) > 1 else 0.0
    error = float(np.sqrt(of_line + of_recording) / slope)
    return Match(float(level), error, target, not x.min() <= level <= x.max())
