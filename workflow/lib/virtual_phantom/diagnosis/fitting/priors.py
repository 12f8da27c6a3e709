"""Gaussian priors of known physics, as a configuration declares them."""

# Imports stay light: every start of the workflow reads this module, and the packages behind fits take seconds to load.

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...base.errors import InputError
from ...physics.effect import Parameter, checked, load

BASELINE_CONFIG_KEY = "diagnosis.recordings: baseline"  # prefix of messages that are about no recording in particular


@dataclass(frozen=True)
class Statement:
    """Prior of a parameter: value and standard deviation (0: known exactly)."""

    value: float
    sd: float

    def variable_prior(self, of: Parameter) -> tuple[float, float]:
        """Return the mean and the standard deviation of the prior of the fit variable (Parameter.to_variable)."""
        ends = [min(max(self.value + side * self.sd, of.low), of.high) for side in (-1, 1)]
        return of.to_variable(self.value), (of.to_variable(ends[1]) - of.to_variable(ends[0])) / 2


@dataclass(frozen=True)
class Label:
    """Prior of a parameter by the scanner's label.

    Attributes
    ----------
    words : str
        Value and uncertainty, for messages; empty: not stated.
    value : float or None
        Expected value; None: not known.
    sd : float
        Standard deviation of the fit variable (Parameter.to_variable).
    low, high : float or None
        Range of values; None: the range of the parameter.
    """

    words: str
    value: float | None = None
    sd: float = 0.0
    low: float | None = None
    high: float | None = None


def stated_physics(declared: Mapping[str, Mapping[str, Statement]]) -> dict[str, dict[str, float]]:
    """Return the prior means, {effect: {parameter: value}}."""
    return {name: {key: stated.value for key, stated in parameters.items()} for name, parameters in declared.items()}


def declared(section: Mapping[str, Mapping[str, Mapping[str, float]]], where: str) -> dict[str, dict[str, Statement]]:
    """Return the priors that a configuration declares, {effect: {parameter: {value, sd}}}.

    Design parameters of the scanner are exact, because fits do not vary them; their standard deviation is ignored.
    Missing parameters that have a value for this case (Parameter.unstated) are exact, too.
    Error messages begin with `where`.

    Raises
    ------
    InputError
        For an unknown effect or parameter, a value out of its range, a pattern of pixels, or a missing parameter.
    """
    found = {}
    for name, parameters in section.items():
        effect = load(name, where)
        if effect.pattern:
            raise InputError(f"{where}: {name} has one unknown per detector pixel, which cannot be stated; remove it")
        checked({name: {key: stated["value"] for key, stated in parameters.items()}}, where)
        unstated = {one.name: one.unstated for one in effect.parameters if one.name not in parameters}
        missing = [key for key, value in unstated.items() if value is None]
        if missing:
            raise InputError(f"{where}.{name}: nothing is stated of {', '.join(missing)}; give value and sd")
        fixed = {parameter.name for parameter in effect.parameters if parameter.stated}
        found[name] = {
            key: Statement(stated["value"], 0.0 if key in fixed else stated["sd"]) for key, stated in parameters.items()
        } | {key: Statement(value, 0.0) for key, value in unstated.items()}
    return found
