"""Hounsfield units and linear attenuation.

HU = 1000 (mu - mu_water) / mu_water, so that water is 0 and vacuum (taken for air) is -1000
(Hounsfield, Br. J. Radiol. 46, 1016, 1973).
"""

import numpy as np

from .errors import InputError

HU_AIR = -1000.0
HU_WATER = 0.0
HU_BODY = -500.0  # half-way from air to water: what is denser belongs to the object


def hu_to_attenuation(hu, mu_water_per_mm: float):
    """Linear attenuation from HU. Values under air are taken as air: it is never negative.

    Parameters
    ----------
    hu : array_like
        HU.
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.

    Returns
    -------
    ndarray
        1/mm, of the type of `hu`; integers become float32.
    """
    hu = _floating(hu)
    return (np.maximum(hu, HU_AIR) / 1000 + 1).astype(hu.dtype, copy=False) * hu.dtype.type(mu_water_per_mm)


def attenuation_to_hu(mu, mu_water_per_mm: float):
    """HU from linear attenuation. Not clipped: noise may carry a voxel below air.

    Parameters
    ----------
    mu : array_like
        Linear attenuation, 1/mm.
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.

    Returns
    -------
    ndarray
        HU, of the type of `mu`; integers become float32.
    """
    mu = _floating(mu)
    return (mu / mu.dtype.type(mu_water_per_mm) - 1) * mu.dtype.type(1000)


def whole_hu(hu: np.ndarray, not_finite: str) -> tuple[np.ndarray, int]:
    """HU as int16, which images are stored in: rounded half to even, and set to the bound beyond its range.

    Parameters
    ----------
    hu : ndarray
        HU, of any shape.
    not_finite : str
        Message of the error where a voxel is NaN or infinite, which no int16 says.

    Returns
    -------
    whole : ndarray of int16
        HU, shaped as `hu`.
    beyond : int
        How many voxels were beyond the range. What that means is for the caller to say: a reconstruction warns of them,
        as metal may rightly be there; an export for other programs refuses them; a page to look at shows the bound.

    Raises
    ------
    InputError
        If a voxel is not finite.
    """
    if not np.isfinite(hu).all():
        raise InputError(not_finite)
    limits = np.iinfo(np.int16)
    whole = np.rint(hu)
    beyond = np.count_nonzero((whole < limits.min) | (whole > limits.max))
    return np.clip(whole, limits.min, limits.max).astype(np.int16), beyond


def _floating(values):
    """The array itself if it holds floats; integers, as images are stored, become float32."""
    values = np.asarray(values)
    return values if np.issubdtype(values.dtype, np.floating) else values.astype(np.float32)
