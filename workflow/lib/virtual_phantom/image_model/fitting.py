"""Fit noise and texture to measured features.

The fits minimize the mean over features of sqrt(1 + z^2), where z = (model - measured) / SD, with the SD over repeats.
This cost grows only linearly with z, so that features that the model cannot reach do not dominate the fit. Every
evaluation uses the same random numbers, which makes the cost an almost smooth function of the parameters. The simplex
search (Nelder-Mead) needs no derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from ..base.streams import Stream, below
from ..features.names import MEAN, VARIANCE
from ..phantom.texture import Component
from .noise import NoiseModel, noisy_images
from .region import RegionModel, gaussian_texture
from .scanner import ImageScanner, features_of

SMOOTH_KERNEL = NoiseModel(2.6, 4.8, 0.15, 0.75, 0.1)  # start of fits: a smooth body kernel, slices of 2 mm
SKEWNESS_LIMIT = 4.5  # of a texture; Component allows 5


@dataclass(frozen=True)
class Measured:
    """Mean and SD over repeats of each feature (index) of a region."""

    mean: pd.Series
    sd: pd.Series

    def misfit(self, features: pd.DataFrame) -> float:
        """Return the mean over features of sqrt(1 + z^2)."""
        z = (features.mean() - self.mean) / self.sd
        return float(np.sqrt(1 + z**2).mean())


def search(cost: Callable[[np.ndarray], float], start: np.ndarray, steps: np.ndarray, evaluations: int) -> np.ndarray:
    """Return the variables with the lowest cost that a simplex search finds in a number of evaluations."""
    simplex = start + np.vstack([np.zeros(len(start)), np.diag(steps)])
    options = {"maxfev": evaluations, "initial_simplex": simplex}
    return minimize(cost, start, method="Nelder-Mead", options=options).x


def fit_noise(
    measured: Measured,
    mask: np.ndarray,
    spacing: tuple[float, float, float],
    stream: Stream,
    *,
    pattern: Component | None = None,
    start: NoiseModel = SMOOTH_KERNEL,
    realizations: int = 1,
    evaluations: int = 220,
) -> tuple[NoiseModel, Component]:
    """Fit the noise of one reconstruction to the features of a uniform region.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
        Voxels of the region.
    spacing : tuple of 3 float
        Voxel size, mm (z, y, x).
    pattern : Component, optional
        Variation of the object inside the region, the same in all scans. By default it is fitted too.

    Returns
    -------
    noise : NoiseModel
    pattern : Component
        Given or fitted. The noise variance is the measured variance less the variance of the pattern.
    """
    variance = measured.mean[VARIANCE]

    def model(x: np.ndarray) -> tuple[NoiseModel, Component]:
        mtf50, ratio, low, slice_sd, tails = np.exp(x[:5]).tolist()
        modeled = pattern or Component(*np.exp(x[5:7]).tolist())
        return NoiseModel(mtf50, mtf50 * (1 + ratio), low, slice_sd, tails), modeled

    def cost(x: np.ndarray) -> float:
        noise, modeled = model(x)
        noise_variance = variance - modeled.sd_hu**2
        if noise_variance <= 0:
            return np.inf
        texture = gaussian_texture(modeled, mask, spacing, below(stream, 0, 1))
        noises = below(stream, 1), range(realizations)
        images = noisy_images(texture, noise, math.sqrt(noise_variance), measured.mean[MEAN], mask, spacing, *noises)
        return measured.misfit(features_of(images, mask, spacing))

    first = [start.mtf50_per_cm, start.mtf10_per_cm / start.mtf50_per_cm - 1, start.low_frequency_per_cm]
    first += [start.slice_sd_mm, start.log_amplitude_sd]
    first += [] if pattern else [0.5 * np.sqrt(variance), 12.0]
    return model(search(cost, np.log(first), np.full(len(first), 0.25), evaluations))


def fit_region(
    scanner: ImageScanner,
    measured: Mapping[str, Measured],
    dose_mgy: float,
    mask: np.ndarray,
    start: RegionModel,
    stream: Stream,
    *,
    realizations: int,
    evaluations: int = 260,
) -> RegionModel:
    """Fit texture and noise factor of a region to its features at one dose, in all reconstructions together.

    Parameters
    ----------
    measured : mapping of str to Measured
        By reconstruction.
    stream : Stream
        The texture's realization is part of the model: predictions must use the same stream.
    realizations : int
        Noise realizations; small regions need more.
    """

    def model(x: np.ndarray) -> RegionModel:
        factor, sd, length, wide_sd, wide_length, contrast = np.exp(x[:6]).tolist()
        fine = Component(sd, length, float(np.clip(x[6], -SKEWNESS_LIMIT, SKEWNESS_LIMIT)))
        return RegionModel(factor, fine, Component(wide_sd, wide_length), contrast)

    def cost(x: np.ndarray) -> float:
        region = model(x)
        if not (0.3 < region.fine.correlation_mm < 30 and 1 < region.coarse.correlation_mm < 40):
            return np.inf
        misfits = []
        for name, known in measured.items():
            noises = range(realizations)
            table = scanner.features(region, mask, known.mean[MEAN], name, dose_mgy, stream, noises)
            misfits.append(known.misfit(table))
        return float(np.mean(misfits))

    fine, coarse = start.fine, start.coarse
    first = [start.noise_factor, fine.sd_hu, fine.correlation_mm, coarse.sd_hu, coarse.correlation_mm, start.contrast]
    steps = np.array([0.15, 0.2, 0.2, 0.3, 0.3, 0.05, 0.4])
    return model(search(cost, np.append(np.log(first), fine.skewness), steps, evaluations))
