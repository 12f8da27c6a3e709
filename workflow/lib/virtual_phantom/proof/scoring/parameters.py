"""How far fitted parameters lie from the concealed ones, and whether their intervals hold them."""

from __future__ import annotations

from collections.abc import Sequence

from ...physics.effect import load
from ..hiding.case import Case
from ..hiding.catalogue import MODELS
from .intervals import median, share

MEANING = (
    "Of effects that were concealed and named: parameters that the generator defines as the library does. Relative "
    "error: fitted - concealed over what was concealed beyond the value that changes nothing. In half-widths: fitted - "
    "concealed over half of the 95 % interval's width."
)


def errors(case: Case) -> list[dict]:
    """Parameters of a case whose truth is comparable, those of effects that were not named left out.

    Returns
    -------
    list of dict
        Each has case, effect, parameter, unit, concealed, fitted, ci95, relative_error (None of what changes nothing),
        half_widths (None of an interval without width) and covered.
    """
    fitted = {effect["name"]: effect["parameters"] for effect in case.diagnosis["effects"]}
    neutral = {(name, one.name): one.neutral or 0.0 for name in fitted for one in load(name).parameters}
    found = []
    for effect in case.truth["effects"]:
        for name, truth in effect["comparable"].items():
            if name not in fitted.get(effect["name"], {}):
                continue
            entry = fitted[effect["name"]][name]
            low, high = entry["ci95"]
            error, size = entry["value"] - truth, truth - neutral.get((effect["name"], name), 0.0)
            found.append(
                {
                    "case": case.name,
                    "effect": effect["name"],
                    "parameter": name,
                    "unit": entry["unit"],
                    "concealed": truth,
                    "fitted": entry["value"],
                    "ci95": [low, high],
                    "relative_error": error / size if size else None,
                    "half_widths": 2 * error / (high - low) if high > low else None,
                    "covered": low <= truth <= high,
                }
            )
    return found


def summary(cases: Sequence[Case]) -> dict:
    """Medians of the absolute errors, coverage in all, by effect and by whose model it is, and every parameter."""
    rows = [row for case in cases for row in errors(case)]
    effects = sorted({row["effect"] for row in rows})
    return {
        "meaning": MEANING,
        "all": _of(rows),
        "by_effect": {name: _of([row for row in rows if row["effect"] == name]) for name in effects},
        "by_model": {model: _of([row for row in rows if row["effect"] in made]) for model, made in MODELS.items()},
        "parameters": rows,
    }


def _of(rows: list[dict]) -> dict:
    return {
        "median_absolute_relative_error": median(_size(row["relative_error"]) for row in rows),
        "median_absolute_half_widths": median(_size(row["half_widths"]) for row in rows),
        "covered": share(row["covered"] for row in rows),
    }


def _size(value: float | None) -> float | None:
    return None if value is None else abs(value)
