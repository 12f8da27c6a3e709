"""Convert between Hounsfield units (HU) and linear attenuation.

HU = 1000 (mu - mu_water) / mu_water, so that water is 0 and vacuum (taken for air) is -1000
(Hounsfield, Br. J. Radiol. 46, 1016, 1973).
"""

import numpy as np

from .errors import InputError

HU_AIR = -1000.0
HU_BODY = -500.0  # halfway from air to water; denser voxels belong to the object


def hu_to_attenuation(hu, mu_water_per_mm: float):
    """Return linear attenuation, 1/mm, from HU in the floating type of `hu`. Values below air become air."""
    hu = _floating(hu)
    return (np.maximum(hu, HU_AIR) / 1000 + 1).astype(hu.dtype, copy=False) * hu.dtype.type(mu_water_per_mm)


def attenuation_to_hu(mu, mu_water_per_mm: float):
    """Return HU from linear attenuation, 1/mm, in the floating type of `mu`; not clipped at air, because of noise."""
    mu = _floating(mu)
    return (mu / mu.dtype.type(mu_water_per_mm) - 1) * mu.dtype.type(1000)


def rounded_hu(hu: np.ndarray, not_finite: str) -> tuple[np.ndarray, int]:
    """Return HU as int16, the type of stored images: rounded half to even, and clipped to the range of int16.

    Parameters
    ----------
    not_finite : str
        Message of the error for NaN or infinite voxels.

    Returns
    -------
    rounded : ndarray of int16
    beyond : int
        Number of clipped voxels, which metal can cause. Reconstructions then warn, exports refuse the image, and report
        pages show the clipped values.

    Raises
    ------
    InputError
        If a voxel is not finite.
    """
    if not np.isfinite(hu).all():
        raise InputError(not_finite)
    limits = np.iinfo(np.int16)
    rounded = np.rint(hu)
    beyond = np.count_nonzero((rounded < limits.min) | (rounded > limits.max))
    return np.clip(rounded, limits.min, limits.max).astype(np.int16), beyond


def _floating(values):
    """Return the array itself if it contains floats, otherwise as float32."""
    values = np.asarray(values)
    return values if np.issubdtype(values.dtype, np.floating) else values.astype(np.float32)
