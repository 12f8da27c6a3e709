"""Noise variance as a function of dose, and of the local noise level in an object.

Quantum noise alone is proportional to 1 / dose. Scanners filter noisier data more strongly, so that the variance rises
less toward low doses. The logarithm of the variance is modeled as a function of log(1 / dose), fitted to the measured
variances of a uniform region. The function is quadratic for three or more doses, and linear for two.

The filter acts on the noise of the data. Where the variance of unfiltered noise is `factor` times its value in the
uniform region, the variance after filtering is the uniform region's variance at dose / factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError


@dataclass(frozen=True)
class DoseLaw:
    """Noise variance of a uniform region, HU^2, by dose, mGy; InputError for fewer than two doses or no noise."""

    variances: Mapping[float, float]

    def __post_init__(self):
        if len(self.variances) < 2 or min(self.variances) <= 0 or min(self.variances.values()) <= 0:
            raise InputError("dose law: give positive noise variances at two or more positive doses")

    @property
    def coefficients(self) -> np.ndarray:
        """Coefficients of log(variance) over log(1 / dose), highest power first."""
        doses, variances = np.array(sorted(self.variances.items())).T
        return np.polyfit(-np.log(doses), np.log(variances), min(2, len(doses) - 1))

    def variance(self, dose_mgy: float, factor: float = 1.0) -> float:
        """Return the noise variance, HU^2, where the unfiltered variance is `factor` times the uniform region's."""
        return float(np.exp(np.polyval(self.coefficients, np.log(factor / dose_mgy))))

    def exponents(self) -> dict[tuple[float, float], float]:
        """Return -d log(variance) / d log(dose) between neighboring doses; 1 for quantum noise alone."""
        doses = sorted(self.variances)
        steps = zip(doses[:-1], doses[1:], strict=True)
        return {(a, b): float(np.log(self.variances[a] / self.variances[b]) / np.log(b / a)) for a, b in steps}
