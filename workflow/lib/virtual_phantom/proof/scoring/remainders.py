"""Test how well the unexplained difference separates cases with missing physics from cases that the library explains.

The result is a curve like a receiver operating characteristic (ROC), and the area under it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..hiding.case import Case
from .intervals import share

MEANING = (
    "The unexplained difference (remainder_sd) is compared with each bound. Lacking: cases with an effect that the "
    "library lacks, for which no equivalent effect was named. Had: cases for which exactly the hidden effects were "
    "named. Both give the share of these cases at or above the bound. Area: probability that a case of the first group "
    "has the larger unexplained difference, with ties counted as half."
)


def summary(cases: Sequence[Case]) -> dict:
    """Return the share of cases reported as unexplained, by hidden effect, and the curve of unexplained differences.

    Returns
    -------
    dict
        * by_kind: {effect that the library lacks: share of its cases that are reported as unexplained}
        * lacking, had: numbers of cases
        * curve: [{bound, lacking, had}] with decreasing bounds
        * area: None if a group is empty
    """
    unknown = [case for case in cases if case.category == "unknown"]
    kinds = sorted({name for case in unknown for name in case.hidden})
    missing = _unexplained(case for case in unknown if not case.equivalent_named)
    explained = _unexplained(case for case in cases if case.in_library and set(case.named) == set(case.hidden))
    bounds = sorted({*missing, *explained}, reverse=True) if missing and explained else []
    return {
        "meaning": MEANING,
        "by_kind": {
            name: share(case.reported_unexplained for case in unknown if name in case.hidden) for name in kinds
        },
        "lacking": len(missing),
        "had": len(explained),
        "curve": [
            {"bound": bound, "lacking": _over(missing, bound), "had": _over(explained, bound)} for bound in bounds
        ],
        "area": area(missing, explained),
    }


def _unexplained(cases: Iterable[Case]) -> list[float]:
    """Return the unexplained differences of cases, except for cases whose two halves share no ray."""
    remainders = (case.diagnosis["remainder_sd"] for case in cases)
    return [value for value in remainders if value is not None]


def _over(values: Sequence[float], bound: float) -> float:
    return sum(value >= bound for value in values) / len(values)


def area(more: Sequence[float], less: Sequence[float]) -> float | None:
    """Return the probability that a value of `more` exceeds one of `less`, ties as half; None if one is empty."""
    if not more or not less:
        return None
    wins = sum((value > other) + 0.5 * (value == other) for value in more for other in less)
    return wins / len(more) / len(less)
