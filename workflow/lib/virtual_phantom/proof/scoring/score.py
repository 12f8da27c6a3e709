"""The score of the blind validation: all numbers in score.json."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from ...physics.effect import names
from ..hiding.case import CATEGORIES, KINDS, Case
from ..hiding.catalogue import CATALOGUE, never_hidden
from ..hiding.hidden_effect import EQUATIONS, STRENGTHS
from . import agreement, calibration, confusion, parameters, remainders
from .headline import headline
from .intervals import median, quantile, share
from .missed import why
from .targets import targets

MEANING = {
    "first": "Cases with one hidden effect of the library: it was ranked first; 1/k if in a group of k effects.",
    "first_or_alternative": "The same; 1 if in a group.",
    "exact": "Cases without a hidden effect that the library lacks: precisely the hidden effects were named, in any "
    "order, none of them in a group. If nothing is hidden: the verdict is a match.",
    "pairs": "Cases with two hidden effects.",
    "beside": "Cases with one or two hidden effects of the library: another effect was named.",
    "left_open": "Cases with one or two hidden effects of the library, all of them named: the verdict reports "
    "unexplained differences.",
    "false_alarms": "Cases without a hidden effect: the verdict was not a match.",
    "unknown": "Cases with a fault that the library lacks: the verdict reports unexplained differences, or precisely "
    "effects were named that the catalogue declares as equivalent before the run.",
    "located": "Cases with stated domains: a significant difference was found in one of them.",
    "excess_removed": (
        "Share of the root mean square beyond noise, on data not fitted, that the named effects remove. It is 0 if an "
        "effect was hidden but none was named, or if nothing was removed. One case in ten is below the tenth "
        "percentile. Compare cases with right and with wrong names before you interpret a share."
    ),
    "remainder_sd": (
        "Unexplained difference that fitted data and data not fitted share, over all rays or voxels. The unit is the "
        "standard deviation for noise alone. Without an unexplained difference, it is 0 in half of the cases and below "
        "1.3 in nine of ten."
    ),
    "models": (
        "If the recordings use the equation of the library, written again, a right name shows that the effect is found "
        "in the scans of another simulator. It does not show that the equation is right."
    ),
}


def score(
    cases: Sequence[Case],
    minutes: float | None = None,
    real: Sequence[dict] = (),
    suite: Mapping | None = None,
    registration: Mapping | None = None,
) -> dict:
    """Return the content of score.json.

    Parameters
    ----------
    minutes : float, optional
        Wall time of the scans and diagnoses on two cores; None if it was not measured.
    real : sequence of dict, optional
        Rows of real recordings (real.row).
    suite : mapping, optional
        Section `proof` of the configuration. None: unknown, and the score cannot be added to the record.
    registration : mapping, optional
        Result of registration.assessed.
    """
    found = {
        "suite": dict(suite or {}),
        "registration": dict(registration or {}),
        "headline": headline(cases),
        "counts": counts(cases),
        "effects": effects(cases),
        "accuracy": accuracy(cases),
        "remainders": remainders.summary(cases),
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
    """Count the cases in all, by category, kind and phantom, and cases with one effect by strength."""
    singles = _in_category(cases, "single")
    return {
        "cases": len(cases),
        "by_category": {name: len(_in_category(cases, name)) for name in CATEGORIES},
        "by_kind": {kind: sum(case.kind == kind for case in cases) for kind in KINDS},
        "by_phantom": dict(sorted(Counter(case.truth["phantom"] for case in cases).items())),
        "single_by_strength": {name: sum(case.strength == name for case in singles) for name in STRENGTHS},
    }


def effects(cases: Sequence[Case]) -> dict:
    """Return the numbers of effects that the library has and that can be hidden, and the sources of their equations.

    Returns
    -------
    dict
        Includes models, `{one of EQUATIONS: {hidden, lacking}}`: hidden effects that the library has, and faults
        that it lacks.
    """
    made = sorted({(one["equation"], one["known"], one["name"]) for case in cases for one in case.truth["effects"]})
    return {
        "meaning": MEANING["models"],
        "sources": EQUATIONS,
        "library": len(names()),
        "can_be_hidden": sum(effect.known for effect in CATALOGUE.values()),
        "never_hidden": never_hidden(),
        "models": {
            source: {
                key: [name for equation, known, name in made if equation == source and known == wanted]
                for key, wanted in (("hidden", True), ("lacking", False))
            }
            for source in EQUATIONS
        },
    }


def accuracy(cases: Sequence[Case]) -> dict:
    """Return shares with Wilson's 95 % intervals, and the meaning of each."""
    singles, pairs, blank = (_in_category(cases, name) for name in ("single", "pair", "none"))
    stated = [case for case in cases if case.truth["where"]]
    tested = {location["domain"] for case in cases for location in case.diagnosis["locations"]}
    return {
        "meaning": MEANING,
        "first": _broken_down(singles, lambda case: case.first_credit),
        "first_or_alternative": _broken_down(singles, lambda case: case.first_or_alternative_right),
        "exact": {"all": share(case.exact for case in cases if case.in_library)}
        | {name: share(case.exact for case in _in_category(cases, name)) for name in CATEGORIES if name != "unknown"},
        "pairs": {
            "both_named": share(case.all_credit for case in pairs),
            "both_named_or_alternatives": share(case.all_or_alternatives_named for case in pairs),
            "one_named": share(bool(set(case.named) & set(case.hidden)) for case in pairs),
        },
        "beside": share(bool(set(case.named) - set(case.hidden)) for case in (*singles, *pairs)),
        "left_open": share(case.unexplained for case in (*singles, *pairs) if case.all_named),
        "false_alarms": share(not case.match for case in blank),
        "unknown": share(case.reported_unexplained for case in _in_category(cases, "unknown")),
        "located": share(case.located for case in stated),
        "domains_never_tested": sorted({domain for case in stated for domain in case.truth["where"]} - tested),
    }


def excess_removed(cases: Sequence[Case]) -> dict:
    """Return how much the named effects remove and leave, by group of cases.

    Returns
    -------
    dict
        Meanings, and

        * in_library: one or two effects of the library; projections and images are the same by kind
        * lacking: an effect that the library lacks
        * right: precisely the hidden effects were named, at least one
        * wrong: an effect was named that is not hidden, in any case
    """
    known = [case for case in cases if case.category in ("single", "pair")]
    groups = {
        "in_library": known,
        **{kind: [case for case in known if case.kind == kind] for kind in KINDS},
        "lacking": _in_category(cases, "unknown"),
        "right": [case for case in cases if case.hidden and case.exact],
        "wrong": [case for case in cases if set(case.named) - set(case.hidden)],
    }
    meaning = {"meaning": MEANING["excess_removed"], "meaning_of_remainder": MEANING["remainder_sd"]}
    return meaning | {name: _removed(group) for name, group in groups.items()}


def _removed(cases: Sequence[Case]) -> dict:
    values = [case.diagnosis["excess_rms_removed"] for case in cases]
    counted = [value or 0.0 for value in values]
    remainders_sd = [case.diagnosis["remainder_sd"] for case in cases]
    return {
        "n": len(values),
        "counted_as_0": values.count(None),
        "median": median(counted),
        "median_where_named": median(values),
        "tenth_percentile": quantile(counted, 0.1),
        "remainder_sd": {
            "median": median(remainders_sd),
            "ninetieth_percentile": quantile(remainders_sd, 0.9),
            "most": quantile(remainders_sd, 1),
        },
    }


def row(case: Case) -> dict:
    """Summarize a case."""
    return {
        "case": case.name,
        "category": case.category,
        "kind": case.kind,
        "phantom": case.truth["phantom"],
        "strength": case.strength,
        "hidden": list(case.hidden),
        "simulator": case.truth["simulator"],
        "geometry": case.truth["geometry"],
        "object": case.truth["object"],
        "imperfections": case.truth["imperfections"],
        "verdict": case.diagnosis["verdict"],
        "sentence": case.diagnosis["sentence"],
        "named": list(case.named),
        "ambiguous_with": {name: sorted(case.with_alternatives(name) - {name}) for name in case.named},
        "right": case.right,
        "located": case.located if case.truth["where"] else None,
        "excess_rms_removed": case.diagnosis["excess_rms_removed"],
        "remainder_sd": case.diagnosis["remainder_sd"],
        "held_out_protocol": bool(case.other),
        "why_missed": why(case),
    }


def _in_category(cases: Sequence[Case], category: str) -> list[Case]:
    return [case for case in cases if case.category == category]


def _broken_down(singles: Sequence[Case], right: Callable[[Case], float]) -> dict:
    effects = sorted({case.hidden[0] for case in singles})
    return {
        "all": share(map(right, singles)),
        "medium_or_strong": share(right(case) for case in singles if case.strength in STRENGTHS[1:]),
        "by_strength": {name: share(right(case) for case in singles if case.strength == name) for name in STRENGTHS},
        "by_kind": {kind: share(right(case) for case in singles if case.kind == kind) for kind in KINDS},
        "by_effect": {name: share(right(case) for case in singles if case.hidden[0] == name) for name in effects},
        "by_equation": {
            source: share(right(case) for case in singles if case.truth["effects"][0]["equation"] == source)
            for source in EQUATIONS
        },
    }
