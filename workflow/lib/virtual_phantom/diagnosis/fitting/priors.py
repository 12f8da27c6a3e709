"""What is stated of a parameter of physics that is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...physics.effect import Parameter


@dataclass(frozen=True)
class Statement:
    """What is stated of a parameter of an effect.

    Attributes
    ----------
    sd : float
        Standard deviation; 0: known exactly.
    """

    value: float
    sd: float

    def number(self, of: Parameter) -> tuple[float, float]:
        """The number that fits vary, and its standard deviation."""
        ends = [min(max(self.value + side * self.sd, of.low), of.high) for side in (-1, 1)]
        return of.number(self.value), (of.number(ends[1]) - of.number(ends[0])) / 2


def stated_physics(declared: Mapping[str, Mapping[str, Statement]]) -> dict[str, dict[str, float]]:
    """Settings of effects as they are stated: {effect: {parameter: value}}."""
    return {name: {key: one.value for key, one in parameters.items()} for name, parameters in declared.items()}
