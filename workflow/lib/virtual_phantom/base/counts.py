"""What a detector reads in one acquisition."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import InputError


@dataclass(frozen=True)
class Counts:
    """What the detector reads in one acquisition.

    data      photons [view, row, column]: whole numbers, or fractions where the detector shares or adds to them
    white     expected photons without an object: I0, or [row, column]
    scale     line integral per unit of -ln(data / white): 1, or p_max in the "astra" model
    """

    data: np.ndarray
    white: float | np.ndarray
    scale: float

    def line_integrals(self, zero_counts_as: float) -> np.ndarray:
        """-scale ln(data / white), float32. Pixels without a photon are read as `zero_counts_as` photons, in (0, 1]."""
        if not 0 < zero_counts_as <= 1:
            raise InputError(f"noise.zero_counts_as {zero_counts_as}: must be over 0 and at most 1 photon")
        photons = np.maximum(self.data, np.float32(zero_counts_as), dtype=np.float32)
        return (-self.scale * np.log(photons / np.asarray(self.white, np.float32))).astype(np.float32)
