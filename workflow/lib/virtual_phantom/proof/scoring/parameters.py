"""Errors of fitted parameters and coverage of their intervals."""

from __future__ import annotations

from collections.abc import Sequence

from ...physics.effect import load, names
from ..hiding.case import Case
from ..hiding.hidden_effect import EQUATIONS
from .intervals import median, share

MEANING = (
    "Hidden effects that were named: parameters with the same definition in both simulators. Relative error: (fitted - "
    "hidden) / (hidden - neutral). In half-widths: (fitted - hidden) over half of the width of the 95 % interval. "
    "Relative width: width of the interval / |hidden - neutral|."
)


def errors(case: Case) -> list[dict]:
    """Compare the fitted parameters of a case with the hidden values.

    Parameters without a comparable definition or an interval, and effects that were not named, are skipped.

    Returns
    -------
    list of dict
        case, effect, equation, parameter, `hidden`, fitted, ci95, relative_error (None for a neutral value),
        relative_width (None for a neutral value), half_widths (None for an interval of zero width) and covered.
    """
    stated = case.verdict.get("parameters", {})
    fitted = {name: stated[name] for name in case.named if name in stated and name in names()}
    neutral = {
        (name, parameter.name): parameter.neutral or 0.0 for name in fitted for parameter in load(name).parameters
    }
    found = []
    for effect in case.truth["effects"]:
        for name, truth in effect["comparable"].items():
            if "ci95" not in fitted.get(effect["name"], {}).get(name, {}):
                continue
            entry = fitted[effect["name"]][name]
            low, high = entry["ci95"]
            error, size = entry["value"] - truth, truth - neutral.get((effect["name"], name), 0.0)
            found.append(
                {
                    "case": case.name,
                    "effect": effect["name"],
                    "equation": effect["equation"],
                    "parameter": name,
                    "hidden": truth,
                    "fitted": entry["value"],
                    "ci95": [low, high],
                    "relative_error": error / size if size else None,
                    "relative_width": (high - low) / abs(size) if size else None,
                    "half_widths": 2 * error / (high - low) if high > low else None,
                    "covered": low <= truth <= high,
                }
            )
    return found


def summary(cases: Sequence[Case]) -> dict:
    """Return median errors and widths and coverage in all, by effect and by source of the equation, and all rows."""
    rows = [row for case in cases for row in errors(case)]
    effects = sorted({row["effect"] for row in rows})
    return {
        "meaning": MEANING,
        "all": _accuracy(rows),
        "by_effect": {name: _accuracy([row for row in rows if row["effect"] == name]) for name in effects},
        "by_equation": {source: _accuracy([row for row in rows if row["equation"] == source]) for source in EQUATIONS},
        "parameters": rows,
    }


def _accuracy(rows: list[dict]) -> dict:
    return {
        "median_absolute_relative_error": median(_size(row["relative_error"]) for row in rows),
        "median_absolute_half_widths": median(_size(row["half_widths"]) for row in rows),
        "median_relative_width": median(row["relative_width"] for row in rows),
        "covered": share(row["covered"] for row in rows),
    }


def _size(value: float | None) -> float | None:
    return None if value is None else abs(value)
