"""The numbers of effects that fits vary."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...physics.effect import LOGARITHM
from .steps import NORMAL_95


@dataclass(frozen=True)
class Unknown:
    """A number of an effect, as fits vary it: a parameter to its power, or its logarithm. Its plausible range, where
    a fit may begin, the one that changes nothing, if there is one, and the Gaussian that it is held by.

    Without further knowledge that is as wide as the range: against runaways.
    """

    effect: str
    name: str
    low: float
    high: float
    starts: tuple[float, ...]
    neutral: float | None
    expected: float
    sd: float
    power: int = 1

    def of(self, value: float) -> float:
        """The number of a parameter's value."""
        return math.log(value) if self.power == LOGARITHM else value**self.power

    def value(self, number: float) -> float:
        """The parameter's value."""
        return math.exp(number) if self.power == LOGARITHM else number ** (1 / self.power)

    def value_error(self, number: float, error: float) -> float:
        """Of the value, from that of the number: so that the 95 % interval reaches at least as far."""
        if self.power == 1 or not np.isfinite(error):
            return error
        if self.power == LOGARITHM:
            error = min(error, self.high - self.low)  # farther than the whole range, and beyond numbers
            ends = [self.value(number + side * NORMAL_95 * error) for side in (-1, 1)]
        else:
            ends = [self.value(max(0.0, number + side * NORMAL_95 * error)) for side in (-1, 1)]
        return max(abs(end - self.value(number)) for end in ends) / NORMAL_95

    @property
    def start(self) -> float:
        return self.starts[0]
