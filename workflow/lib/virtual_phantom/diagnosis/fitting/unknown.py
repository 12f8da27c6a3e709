"""Parameters of effects as variables of a fit, which may be a power or the logarithm of the parameter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...physics.effect import LOGARITHM, OF_PROTOCOL, OF_SCAN, Parameter, load
from .steps import NORMAL_95, ROUNDING


@dataclass(frozen=True)
class Unknown:
    """Variable of a fit for one parameter of an effect: a power of the parameter, or its logarithm.

    Attributes
    ----------
    parameter : Parameter
        Parameter of the effect in the recorded scan.
    low, high : float
        Plausible range.
    starts : tuple of float
        Starting points of fits.
    neutral : float or None
        Value of the variable at which the effect does nothing, if there is one.
    expected, sd : float
        Gaussian prior. Without further knowledge it is as wide as the range, so that fits do not diverge.
    """

    effect: str
    parameter: Parameter
    low: float
    high: float
    starts: tuple[float, ...]
    neutral: float | None
    expected: float
    sd: float

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.parameter.name

    def of(self, value: float) -> float:
        """Return the variable for a value of the parameter."""
        return self.parameter.to_variable(value)

    def value(self, number: float) -> float:
        """Return the value of the parameter for a value of the variable."""
        power = self.parameter.power
        return math.exp(number) if power == LOGARITHM else number ** (1 / power)

    def value_error(self, number: float, error: float) -> float:
        """Return the standard error of the parameter.

        The 95 % interval of the parameter contains the transformed 95 % interval of the variable.
        """
        power = self.parameter.power
        if power == 1 or not np.isfinite(error):
            return error
        if power == LOGARITHM:
            error = min(error, self.high - self.low)  # more than the whole range overflows
            ends = [self.value(number + side * NORMAL_95 * error) for side in (-1, 1)]
        else:
            ends = [self.value(max(0.0, number + side * NORMAL_95 * error)) for side in (-1, 1)]
        return max(abs(end - self.value(number)) for end in ends) / NORMAL_95

    def number_error(self, value: float, error: float) -> float:
        """Return the standard error of the variable.

        This is the inverse of `value_error`, or its smallest solution if an end of the interval was cut.
        """
        power = self.parameter.power
        if power == 1 or not np.isfinite(error):
            return error
        reach = NORMAL_95 * error
        other = value - reach if power != LOGARITHM and value >= (1 - ROUNDING) * reach else value + reach
        return abs(self.of(other) - self.of(value)) / NORMAL_95

    @property
    def moves(self) -> bool:
        """Whether the parameter displaces rays or the object to first order."""
        return load(self.effect).moves(self.parameter)

    def owner(self, recording: str, protocol: str) -> str:
        """Return the recording or protocol to which the value belongs; empty if it is common to the scanner."""
        belongs_to = self.parameter.belongs_to
        if belongs_to == OF_SCAN:
            return recording
        return f"protocol {protocol}" if belongs_to == OF_PROTOCOL and protocol else ""

    @property
    def start(self) -> float:
        """The first of `starts`."""
        return self.starts[0]
