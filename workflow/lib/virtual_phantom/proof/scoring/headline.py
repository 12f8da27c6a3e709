"""The score of a program: shares of right verdicts, in all and by class of cases.

Only truths and verdict documents are needed, so that the verdicts of any program can be scored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ..hiding.case import Case
from ..hiding.hidden_effect import STRENGTHS
from . import parameters
from .intervals import share
from .rule import LEAST_IN_CLASS, RULE, VERSION

HIGHER_IS_WORSE = ("left_open", "false_alarms", "false_alarms_undeclared")
CLASSES = ("simulator", "geometry", "object", "effect")


def headline(cases: Sequence[Case]) -> dict:
    """Return the score of a program.

    Returns
    -------
    dict
        rule (version and text), and

        * all: {quantity: share} over cases without the library's own equations
        * own: {quantity: share} over the other cases
        * by_significance: as `all`, with all named effects counted, however irrelevant
        * classes: {one of CLASSES: {class: {quantity: share}}}, as `all`
        * worst: {quantity: {kind, class, and its share}}, the worst class with at least LEAST_IN_CLASS scores
    """
    counted = [case for case in cases if not case.own_equation]
    classes = {kind: _by_class(counted, kind) for kind in CLASSES}
    return {
        "rule": {"version": VERSION, "text": RULE},
        "all": shares(counted),
        "own": shares([case for case in cases if case.own_equation]),
        "by_significance": shares([case.by_significance for case in counted]),
        "classes": classes,
        "worst": {name: found for name in SCORES if (found := _worst(name, classes))},
    }


def shares(cases: Sequence[Case]) -> dict:
    """Return {quantity: share with Wilson's 95 % interval}."""
    return {name: share(scores(cases)) for name, scores in SCORES.items()}


def _singles(*strengths: str) -> Callable[[Sequence[Case]], list[float]]:
    return lambda cases: [
        case.first_credit for case in cases if case.category == "single" and case.strength in strengths
    ]


def _false_alarms(undeclared: bool) -> Callable[[Sequence[Case]], list[bool]]:
    return lambda cases: [not case.match for case in cases if case.category == "none" and case.undeclared == undeclared]


# Names as in statistics.proof_record.QUANTITIES
SCORES: dict[str, Callable[[Sequence[Case]], Sequence[float]]] = {
    "first_medium_or_strong": _singles(*STRENGTHS[1:]),
    "first_weak": _singles(STRENGTHS[0]),
    "exact": lambda cases: [case.exact for case in cases if case.category in ("single", "pair")],
    "left_open": lambda cases: [
        case.unexplained for case in cases if case.category in ("single", "pair") and case.all_named
    ],
    "pairs": lambda cases: [case.all_credit for case in cases if case.category == "pair"],
    "false_alarms": _false_alarms(undeclared=False),
    "false_alarms_undeclared": _false_alarms(undeclared=True),
    "unknown": lambda cases: [case.reported_unexplained for case in cases if case.category == "unknown"],
    "intervals": lambda cases: [row["covered"] for case in cases for row in parameters.errors(case)],
}


def _by_class(cases: Sequence[Case], kind: str) -> dict:
    values = sorted({case.classes[kind] for case in cases if kind in case.classes})
    return {value: shares([case for case in cases if case.classes.get(kind) == value]) for value in values}


def _worst(name: str, classes: Mapping) -> dict | None:
    found = [
        {"kind": kind, "class": value} | counted[name]
        for kind, values in classes.items()
        for value, counted in values.items()
        if len(values) > 1 and counted[name]["n"] >= LEAST_IN_CLASS
    ]
    sign = -1 if name in HIGHER_IS_WORSE else 1
    return min(found, key=lambda entry: (sign * entry["share"], -entry["n"]), default=None)
