"""The score of the blind test: every number that score.json holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from . import agreement, calibration, confusion, parameters
from .case import ADMITTED, CATEGORIES, KINDS, MATCH, Case
from .catalogue import STRENGTHS
from .intervals import median, share
from .missed import why
from .targets import targets

MEANING = {
    "first": "Cases with one concealed effect of the library: it was named first.",
    "first_or_stand_in": "The same, or it was reported to explain the data as well as the one named first.",
    "exact": "Cases whose concealed effects the library has, or with none: precisely these were named, in any order; "
    "of nothing, a match.",
    "pairs": "Cases with two concealed effects.",
    "beside": "Cases with one or two concealed effects of the library: something was named that is not among them.",
    "left_open": "Cases with one or two concealed effects of the library, all of them named: the verdict left "
    "something unexplained all the same.",
    "false_alarms": "Cases with nothing concealed: the verdict was not a match.",
    "unknown": "Cases with an effect that the library lacks: the verdict owned up to something unexplained.",
    "located": "Cases with stated domains: a significant difference was found in one of them.",
    "excess_removed": (
        "Share of the difference beyond noise, on data not fitted, that the named effects remove. Where something was "
        "concealed and nothing named, or nothing gained, it counts as 0. What is left counts from three standard "
        "deviations of its noise on: of a weak effect, all may seem removed where much is not seen."
    ),
}


def score(cases: Sequence[Case], minutes: float | None = None, real: Sequence[dict] = ()) -> dict:
    """What score.json holds.

    minutes   that its scans and diagnoses took over two cores; None: not measured
    real      rows of real recordings (real.row)
    """
    found = {
        "counts": counts(cases),
        "accuracy": accuracy(cases),
        "parameters": parameters.summary(cases),
        "excess_removed": excess_removed(cases),
        "agreement": agreement.summary(cases),
        "confusion": confusion.matrix(cases),
        "calibration": calibration.tables(cases),
        "cases": [row(case) for case in cases],
        "recordings": list(real),
    }
    return {"targets": targets(found, minutes)} | found


def counts(cases: Sequence[Case]) -> dict:
    singles = _of(cases, "single")
    return {
        "cases": len(cases),
        "by_category": {name: len(_of(cases, name)) for name in CATEGORIES},
        "by_kind": {kind: sum(case.kind == kind for case in cases) for kind in KINDS},
        "by_phantom": dict(sorted(Counter(case.truth["phantom"] for case in cases).items())),
        "single_by_strength": {name: sum(case.strength == name for case in singles) for name in STRENGTHS},
    }


def accuracy(cases: Sequence[Case]) -> dict:
    """Shares with Wilson's 95 % intervals, and what each means."""
    singles, pairs, blank = (_of(cases, name) for name in ("single", "pair", "none"))
    stated = [case for case in cases if case.truth["where"]]
    tested = {place["domain"] for case in cases for place in case.diagnosis["locations"]}
    return {
        "meaning": MEANING,
        "first": _broken_down(singles, lambda case: case.first_right),
        "first_or_stand_in": _broken_down(singles, lambda case: case.first_or_stand_in_right),
        "exact": {"all": share(case.exact for case in cases if case.in_library)}
        | {name: share(case.exact for case in _of(cases, name)) for name in CATEGORIES if name != "unknown"},
        "pairs": {
            "both_named": share(case.all_named for case in pairs),
            "both_named_or_stand_ins": share(case.all_or_stand_ins_named for case in pairs),
            "one_named": share(bool(set(case.named) & set(case.concealed)) for case in pairs),
        },
        "beside": share(bool(set(case.named) - set(case.concealed)) for case in (*singles, *pairs)),
        "left_open": share(case.verdict in ADMITTED for case in (*singles, *pairs) if case.all_named),
        "false_alarms": share(case.verdict != MATCH for case in blank),
        "unknown": share(case.verdict in ADMITTED for case in _of(cases, "unknown")),
        "located": share(case.located for case in stated),
        "domains_never_tested": sorted({domain for case in stated for domain in case.truth["where"]} - tested),
    }


def excess_removed(cases: Sequence[Case]) -> dict:
    """Medians over cases in which the library has what was concealed, and over those in which it lacks it."""
    found = {"meaning": MEANING["excess_removed"]}
    for name, categories in (("in_library", ("single", "pair")), ("lacking", ("unknown",))):
        values = [case.diagnosis["excess_removed"] for case in cases if case.category in categories]
        found[name] = {
            "n": len(values),
            "counted_as_0": values.count(None),
            "median": median(value or 0.0 for value in values),
            "median_where_named": median(values),
        }
    return found


def row(case: Case) -> dict:
    """One case in short."""
    return {
        "case": case.name,
        "category": case.category,
        "kind": case.kind,
        "phantom": case.truth["phantom"],
        "strength": case.strength,
        "concealed": list(case.concealed),
        "verdict": case.verdict,
        "sentence": case.diagnosis["sentence"],
        "named": list(case.named),
        "ambiguous_with": {name: sorted(case.with_stand_ins(name) - {name}) for name in case.named},
        "right": case.right,
        "located": case.located if case.truth["where"] else None,
        "excess_removed": case.diagnosis["excess_removed"],
        "held_out_protocol": bool(case.other),
        "why_missed": why(case),
    }


def _of(cases: Sequence[Case], category: str) -> list[Case]:
    return [case for case in cases if case.category == category]


def _broken_down(singles: Sequence[Case], right: Callable[[Case], bool]) -> dict:
    effects = sorted({case.concealed[0] for case in singles})
    return {
        "all": share(map(right, singles)),
        "medium_or_strong": share(right(case) for case in singles if case.strength in STRENGTHS[1:]),
        "by_strength": {name: share(right(case) for case in singles if case.strength == name) for name in STRENGTHS},
        "by_kind": {kind: share(right(case) for case in singles if case.kind == kind) for kind in KINDS},
        "by_effect": {name: share(right(case) for case in singles if case.concealed[0] == name) for name in effects},
    }
