"""Whether what a diagnosis states of its certainty holds: shares that came true beside the least that was stated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.special import expit

from ...diagnosis.selection.forward_selection import AS_GOOD
from ..hiding.case import EXPLAINED, MATCH, PARTLY, UNEXPLAINED, Case
from .intervals import share

GAINS = (-np.inf, 10.0, 30.0, 100.0, 1000.0, np.inf)
# Bounds of classes of p: most are far below what any test needs.
CHANCES = (0.0, 1e-300, 1e-100, 1e-30, 1e-10, 1.0)
MEANING = {
    "first_named": (
        "Cases in which something was named. Without alternatives, every other effect in its place loses at least "
        f"{AS_GOOD:g} of log score on data not fitted: odds of {np.exp(AS_GOOD):.0f} to 1 against each. With k "
        "alternatives, the one named is the best of k + 1 that the data hardly tell apart."
    ),
    "gain": (
        "Every named effect by the log score that data not fitted lose without it, the others refitted: odds of "
        "exp(gain) that something like it is there; stated is that of the least certain in the line. Came true: the "
        "effect was concealed."
    ),
    "p": (
        "Every named effect by the chance of such a likelihood ratio without it, over all candidates. Came true: the "
        "effect was concealed. Stated is 1 - p, of the least certain in the line."
    ),
    "ruled_out": (
        "Every effect that a diagnosis rules out: in each place it loses 10 or more of log score. Came true: it was "
        "not concealed."
    ),
    "verdict": (
        "Every case by its verdict. A match states that nothing is concealed; explained, that precisely the effects "
        "named are; partly explained, that more than the effects named is; unexplained, that something is which the "
        "library lacks."
    ),
    "stated": (
        "Stated at least: what follows from the log score if the library holds the right physics; kept is false "
        "(coloured on the page) where it lies above the 95 % interval of the share that came true. Such statements "
        "hold among models of the library. In all cases: those with effects that the library lacks as well."
    ),
}


def tables(cases: Sequence[Case]) -> dict:
    """Reliability by what is stated.

    Returns
    -------
    dict
        {table: [{stated, stated_at_least, came_true, with_lacking, kept}]}, with what each means. with_lacking holds
        came_true over all cases, those among them that conceal an effect which the library lacks. first_named has
        came_true for the effect itself and, as or_stand_in, for it or its stand-ins.
    """
    return {
        "meaning": MEANING,
        "first_named": [
            _first_named(label, cases, fits)
            for label, fits in (
                ("no alternative", lambda count: count == 0),
                ("one alternative", lambda count: count == 1),
                ("more alternatives", lambda count: count > 1),
            )
        ],
        "gain": _by_evidence("gain", "held_out_gain", cases, GAINS, lambda gains: float(expit(min(gains)))),
        "p": _by_evidence("p", "p", cases, CHANCES, lambda chances: 1 - max(chances)),
        "ruled_out": [
            _line(
                "ruled out",
                None,
                [(case, name not in case.concealed) for case in cases for name in case.diagnosis["ruled_out"]],
            )
        ],
        "verdict": [
            _line(verdict, None, [(case, holds(case)) for case in cases if case.verdict == verdict])
            for verdict, holds in STATEMENTS.items()
        ],
    }


STATEMENTS: dict[str, Callable[[Case], bool]] = {
    MATCH: lambda case: case.category == "none",
    EXPLAINED: lambda case: case.exact,
    PARTLY: lambda case: not set(case.concealed) <= set(case.named),
    UNEXPLAINED: lambda case: not case.in_library,
}


def _first_named(label: str, cases: Sequence[Case], fits: Callable[[int], bool]) -> dict:
    taken = [case for case in cases if case.first and fits(len(case.with_stand_ins(case.first)) - 1)]
    members = [len(case.with_stand_ins(case.first)) for case in taken if case.in_library]
    # The mean of what the cases state: alone, the odds against the next best; else one of the group.
    alone = float(expit(AS_GOOD))
    stated = float(np.mean([alone if count == 1 else 1 / count for count in members])) if members else None
    line = _line(label, stated, [(case, case.first_right) for case in taken])
    return line | {"or_stand_in": share(case.first_or_stand_in_right for case in taken if case.in_library)}


def _line(label: str, stated: float | None, judged: Iterable[tuple[Case, bool]]) -> dict:
    judged = list(judged)
    came = share(true for case, true in judged if case.in_library)
    kept = None if stated is None or not came["n"] else bool(came["ci95"][1] >= stated)
    return {
        "stated": label,
        "stated_at_least": None if stated is None else float(stated),
        "came_true": came,
        "with_lacking": share(true for _, true in judged),
        "kept": kept,
    }


def _by_evidence(label: str, key: str, cases: Sequence[Case], edges: Sequence[float], stated: Callable) -> list[dict]:
    """Lines of named effects by a number of their evidence; `stated` takes the numbers of a line."""
    found = [
        (effect["evidence"][key], case, effect["name"] in case.concealed)
        for case in cases
        for effect in case.diagnosis["effects"]
        if effect["evidence"][key] is not None
    ]
    lines = []
    for low, high in zip(edges, edges[1:], strict=False):
        within = [one for one in found if low <= one[0] < high or one[0] == high == edges[-1]]
        if within:
            judged = [(case, true) for _, case, true in within]
            lines.append(_line(f"{label} {_span(low, high)}", stated([one[0] for one in within]), judged))
    return lines


def _span(low: float, high: float) -> str:
    if low in (0, -np.inf):
        return f"under {high:g}"
    return f"{low:g} or more" if high in (1, np.inf) else f"{low:g} to {high:g}"
