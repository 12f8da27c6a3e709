"""Detector counts of one acquisition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import InputError


@dataclass(frozen=True)
class Counts:
    """Detector counts of one acquisition.

    Attributes
    ----------
    data : ndarray, shape (views, rows, columns)
        Photons: integers, or fractions after charge sharing or other detector effects.
    white : float or ndarray, shape (rows, columns)
        Expected photons without an object; one number, I0, if all pixels are equal.
    scale : float
        Line integral per unit of -ln(data / white): 1, or p_max in the "astra" model.
    """

    data: np.ndarray
    white: float | np.ndarray
    scale: float

    def line_integrals(self, zero_counts_as: float) -> np.ndarray:
        """Return -scale ln(data / white), float32, (views, rows, columns); `zero_counts_as` is the smallest count used.

        Raises
        ------
        InputError
            If `zero_counts_as` is not in (0, 1].
        """
        if not 0 < zero_counts_as <= 1:
            raise InputError(f"noise.zero_counts_as {zero_counts_as}: must be over 0 and at most 1 photon")
        photons = np.maximum(self.data, np.float32(zero_counts_as), dtype=np.float32)
        photons /= np.asarray(self.white, np.float32)  # in place, because a scan has hundreds of megabytes
        np.log(photons, out=photons)
        photons *= np.float32(-self.scale)
        return photons
