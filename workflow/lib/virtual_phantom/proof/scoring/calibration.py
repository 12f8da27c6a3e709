"""Reliability of the certainty that a diagnosis states: stated probabilities and the shares that came true."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.special import expit

from ...diagnosis.selection.forward_selection import AS_GOOD, RULED_OUT
from ...diagnosis.verdict_text import EXPLAINED, MATCH, PARTLY_EXPLAINED, PRACTICAL, UNEXPLAINED
from ..hiding.case import Case
from .intervals import share

GAINS = (-np.inf, 10.0, 30.0, 100.0, 1000.0, np.inf)
# Bounds of the classes of p. Most p are far below any significance level.
CHANCES = (0.0, 1e-300, 1e-100, 1e-30, 1e-10, 1.0)
MEANING = {
    "first_named": (
        "Cases in which an effect was named. Without alternatives, each other effect has a log score on data not "
        f"fitted that is at least {AS_GOOD:g} lower: odds of {np.exp(AS_GOOD):.0f} to 1. With k alternatives, the "
        "named effect is the best of k + 1 that the data hardly distinguish."
    ),
    "gain": (
        "Named effects by the loss of log score on data not fitted if the effect is removed and the others are "
        "refitted. The odds are exp(gain) that the effect or a similar one is present. Stated is the probability of "
        "the least certain effect in the line. Came true: the effect was hidden."
    ),
    "p": (
        "Named effects by the probability of such a likelihood ratio without the effect, over all candidates. Stated "
        "is 1 - p of the least certain effect in the line. Came true: the effect was hidden."
    ),
    "ruled_out": (
        "Effects that a diagnosis rules out: as a replacement of any named effect, the log score is lower by "
        f"{RULED_OUT:g} or more. Came true: the effect was not hidden."
    ),
    "verdict": (
        "Cases by verdict. A match states that nothing is hidden. Explained states that precisely the named effects "
        "are hidden. Partly explained states that further effects are hidden. Unexplained states that the library "
        "lacks a hidden effect."
    ),
    "stated": (
        "Stated at least: probability from the log score if the library contains the right physics. Kept is false "
        "(colored on the page) if it is above the 95 % interval of the share that came true. Such statements are valid "
        "among models of the library. In all cases: including effects that the library lacks."
    ),
}


def tables(cases: Sequence[Case]) -> dict:
    """Return the reliability of each kind of statement.

    Returns
    -------
    dict
        {table: [{stated, stated_at_least, came_true, with_lacking, kept}]}, and the meaning of each. came_true is the
        share over cases whose hidden effects the library has, with_lacking the share over all cases. In first_named,
        came_true counts the effect itself; or_alternative also counts its alternatives.
    """
    ruled_out = [(case, name not in case.hidden) for case in cases for name in case.diagnosis["ruled_out"]]
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
        "ruled_out": [_line("ruled out", None, ruled_out)],
        "verdict": [
            _line(verdict, None, [(case, holds(case)) for case in cases if case.diagnosis["verdict"] == verdict])
            for verdict, holds in STATEMENTS.items()
        ],
    }


STATEMENTS: dict[str, Callable[[Case], bool]] = {
    MATCH: lambda case: case.category == "none",
    PRACTICAL: lambda case: case.category == "none",
    EXPLAINED: lambda case: case.exact,
    PARTLY_EXPLAINED: lambda case: not set(case.hidden) <= set(case.named),
    UNEXPLAINED: lambda case: not case.in_library,
}


def _first_named(label: str, cases: Sequence[Case], fits: Callable[[int], bool]) -> dict:
    taken = [case for case in cases if case.first and fits(len(case.with_alternatives(case.first)) - 1)]
    members = [len(case.with_alternatives(case.first)) for case in taken if case.in_library]
    # Mean over cases: without alternatives the odds against the next best effect, else 1 / size of the group.
    alone = float(expit(AS_GOOD))
    stated = float(np.mean([alone if count == 1 else 1 / count for count in members])) if members else None
    line = _line(label, stated, [(case, case.first_right) for case in taken])
    return line | {"or_alternative": share(case.first_or_alternative_right for case in taken if case.in_library)}


def _line(label: str, stated: float | None, judged: Iterable[tuple[Case, bool]]) -> dict:
    judged = list(judged)
    came_true = share(true for case, true in judged if case.in_library)
    kept = None if stated is None or not came_true["n"] else bool(came_true["ci95"][1] >= stated)
    return {
        "stated": label,
        "stated_at_least": None if stated is None else float(stated),
        "came_true": came_true,
        "with_lacking": share(true for _, true in judged),
        "kept": kept,
    }


def _by_evidence(label: str, key: str, cases: Sequence[Case], edges: Sequence[float], stated: Callable) -> list[dict]:
    """Return a line per range of a number in the evidence; `stated` maps the numbers of a line to a probability."""
    found = [
        (effect["evidence"][key], case, effect["name"] in case.hidden)
        for case in cases
        for effect in case.diagnosis["effects"]
        if effect["evidence"][key] is not None
    ]
    lines = []
    for low, high in zip(edges, edges[1:], strict=False):
        within = [item for item in found if low <= item[0] < high or item[0] == high == edges[-1]]
        if within:
            judged = [(case, true) for _, case, true in within]
            lines.append(_line(f"{label} {_span(low, high)}", stated([item[0] for item in within]), judged))
    return lines


def _span(low: float, high: float) -> str:
    if low in (0, -np.inf):
        return f"under {high:g}"
    return f"{low:g} or more" if high in (1, np.inf) else f"{low:g} to {high:g}"
