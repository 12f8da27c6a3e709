"""Variance of image noise against dose, and between positions of an object.

Quantum noise alone is proportional to 1 / dose. Scanners filter noisier data more strongly, so that the variance rises
less toward low doses. Measured variances of a uniform region at three or more doses give the logarithm of the variance
as a quadratic function of log(1 / dose).

The filter acts on the noise of the data. Where unfiltered noise is `factor` times that of the uniform region, the
variance is therefore what the uniform region would have at dose / factor.
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
        """Return the noise variance, HU^2, where unfiltered noise is `factor` times that of the uniform region."""
        return float(np.exp(np.polyval(self.coefficients, np.log(factor / dose_mgy))))

    def exponents(self) -> dict[tuple[float, float], float]:
        """Return -d log(variance) / d log(dose) between neighboring doses; 1 for quantum noise alone."""
        doses = sorted(self.variances)
        steps = zip(doses[:-1], doses[1:], strict=True)
        return {(a, b): float(np.log(self.variances[a] / self.variances[b]) / np.log(b / a)) for a, b in steps}
