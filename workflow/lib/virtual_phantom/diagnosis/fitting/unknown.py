"""The numbers of effects that fits vary."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...physics.effect import LOGARITHM, OF_PROTOCOL, OF_SCAN, Parameter, load
from .steps import NORMAL_95, ROUNDING


@dataclass(frozen=True)
class Unknown:
    """A number of an effect, as fits vary it: a parameter to its power, or its logarithm.

    Attributes
    ----------
    effect, name : str
        Of the parameter.
    low, high : float
        Plausible range.
    starts : tuple of float
        Where a fit may begin.
    neutral : float or None
        The one that changes nothing, if there is one.
    expected, sd : float
        The Gaussian that it is held by. Without further knowledge that is as wide as the range: against runaways.
    power : int
        As in Parameter.
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
        """Standard error of the value: such that the 95 % interval reaches at least as far as the number's.

        Parameters
        ----------
        number, error : float
            The number, and its standard error.
        """
        if self.power == 1 or not np.isfinite(error):
            return error
        if self.power == LOGARITHM:
            error = min(error, self.high - self.low)  # farther than the whole range, and beyond numbers
            ends = [self.value(number + side * NORMAL_95 * error) for side in (-1, 1)]
        else:
            ends = [self.value(max(0.0, number + side * NORMAL_95 * error)) for side in (-1, 1)]
        return max(abs(end - self.value(number)) for end in ends) / NORMAL_95

    def number_error(self, value: float, error: float) -> float:
        """Standard error of the number, of which `value_error` makes that of a value; the least where ends were cut."""
        if self.power == 1 or not np.isfinite(error):
            return error
        reach = NORMAL_95 * error
        other = value - reach if self.power != LOGARITHM and value >= (1 - ROUNDING) * reach else value + reach
        return abs(self.of(other) - self.of(value)) / NORMAL_95

    @property
    def parameter(self) -> Parameter:
        """Of which it is the number."""
        return next(one for one in load(self.effect).parameters if one.name == self.name)

    @property
    def moves(self) -> bool:
        """Whether it displaces rays or the object, to first order."""
        return load(self.effect).moves(self.parameter)

    def owner(self, recording: str, protocol: str) -> str:
        """Whose it is.

        Parameters
        ----------
        recording, protocol : str
            Where it is fitted; no protocol (empty): there is one alone.

        Returns
        -------
        str
            Empty: the scanner's; else the protocol or the recording.
        """
        belongs_to = self.parameter.belongs_to
        if belongs_to == OF_SCAN:
            return recording
        return f"protocol {protocol}" if belongs_to == OF_PROTOCOL and protocol else ""

    @property
    def start(self) -> float:
        """The first of `starts`."""
        return self.starts[0]
