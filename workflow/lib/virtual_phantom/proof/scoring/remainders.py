"""How well what is left tells cases that the library lacks something for from those that it has everything for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..hiding.case import Case
from .intervals import share

MEANING = (
    "By the standard deviations that are left (remainder_sd), for every bound on them: the share of cases with a fault "
    "that the library lacks, without an equal among what is named, that lie over it, and the share of cases of the "
    "library's effects, all named and none beside, or of nothing, that do. Area: the chance that one of the first has "
    "more left than one of the second, equal numbers counted as half."
)


def summary(cases: Sequence[Case]) -> dict:
    """Owned-up cases by kind, and the curve of remainders.

    Returns
    -------
    dict
        by_kind, {kind: share}; lacking and had, their numbers; curve, [{bound, lacking, had}], bounds falling; area,
        None where either is missing.
    """
    unknown = [case for case in cases if case.category == "unknown"]
    kinds = sorted({name for case in unknown for name in case.concealed})
    lacking = _left(case for case in unknown if not case.equal_named)
    had = _left(case for case in cases if case.in_library and set(case.named) == set(case.concealed))
    bounds = sorted({*lacking, *had}, reverse=True) if lacking and had else []
    return {
        "meaning": MEANING,
        "by_kind": {name: share(case.owned_up for case in unknown if name in case.concealed) for name in kinds},
        "lacking": len(lacking),
        "had": len(had),
        "curve": [{"bound": bound, "lacking": _over(lacking, bound), "had": _over(had, bound)} for bound in bounds],
        "area": area(lacking, had),
    }


def _left(cases: Iterable[Case]) -> list[float]:
    """What is left of cases, but for those whose halves share no ray."""
    left = (case.diagnosis["remainder_sd"] for case in cases)
    return [one for one in left if one is not None]


def _over(values: Sequence[float], bound: float) -> float:
    return sum(value >= bound for value in values) / len(values)


def area(more: Sequence[float], less: Sequence[float]) -> float | None:
    """The chance that a value of the first is larger than one of the second, equal ones counted as half.

    Returns
    -------
    float or None
        None if either is empty.
    """
    if not more or not less:
        return None
    wins = sum((one > other) + 0.5 * (one == other) for one in more for other in less)
    return wins / len(more) / len(less)
