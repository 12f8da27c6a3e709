"""Physics that is known of a scanner, as a configuration declares it.

Apart from `pulls`: every start of the workflow reads this, and what is behind fits takes seconds to import.
"""

from __future__ import annotations

from collections.abc import Mapping

from ...base.errors import InputError
from ...physics.effect import checked, load
from .priors import Statement

BASELINE = "diagnosis.recordings: baseline"  # what messages begin with where no recording is named


def declared(section: Mapping[str, Mapping[str, Mapping[str, float]]], where: str) -> dict[str, dict[str, Statement]]:
    """What a configuration declares.

    Parameters of the scanner's design, which no fit varies, are taken at their value whatever their standard deviation.

    Parameters
    ----------
    section : mapping
        {effect: {parameter: {value, sd}}}.
    where : str
        What messages begin with.

    Raises
    ------
    InputError
        For an effect or a parameter that the library does not have, a value out of its range, a pattern of pixels,
        and parameters of which nothing is stated.
    """
    found = {}
    for name, parameters in section.items():
        effect = load(name, where)
        if effect.pattern:
            raise InputError(f"{where}: {name} has one unknown per detector pixel, which nobody can state; take it out")
        checked({name: {key: one["value"] for key, one in parameters.items()}}, where)
        missing = [one.name for one in effect.parameters if one.name not in parameters]
        if missing:
            raise InputError(f"{where}.{name}: nothing is stated of {', '.join(missing)}; give value and sd")
        fixed = {one.name for one in effect.parameters if one.stated}
        found[name] = {
            key: Statement(one["value"], 0.0 if key in fixed else one["sd"]) for key, one in parameters.items()
        }
    return found
