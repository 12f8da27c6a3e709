"""The score of the blind test: every number that score.json holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from ...physics.effect import names
from ...statistics.proof_record import SeedResult
from ..hiding.case import ADMITTED, CATEGORIES, KINDS, MATCH, Case
from ..hiding.catalogue import CATALOGUE, MODELS, STRENGTHS, never_concealed
from . import agreement, calibration, confusion, parameters, record, remainders
from .intervals import median, quantile, share
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
    "unknown": "Cases with a fault that the library lacks: the verdict says that something is left unexplained, or "
    "names what the catalogue had called an equal before the run, and nothing else.",
    "located": "Cases with stated domains: a significant difference was found in one of them.",
    "excess_removed": (
        "Share of the difference beyond noise, on data not fitted, that the named effects remove. Where something was "
        "concealed and nothing named, or nothing gained, it counts as 0. What is left counts from three standard "
        "deviations of its noise on: of a weak effect, all may seem removed where much is not seen. One case in ten "
        "lies under the tenth percentile. Compare right with wrong names before a share is taken to show anything."
    ),
    "remainder_sd": (
        "What is left in common on fitted data and data not fitted, over all rays or voxels, in standard deviations of "
        "what noise alone gives: 0 in half of the cases and under 1.3 in nine of ten if nothing is left."
    ),
    "models": (
        "Where the library's equation is written again, a right name shows that the effect is found in another "
        "simulator's scans, not that the equation is right."
    ),
}


def score(
    cases: Sequence[Case],
    minutes: float | None = None,
    real: Sequence[dict] = (),
    suite: Mapping | None = None,
    entries: Sequence[SeedResult] = (),
) -> dict:
    """What score.json holds.

    Parameters
    ----------
    minutes : float, optional
        That the suite's scans and diagnoses took over two cores; None: not measured.
    real : sequence of dict, optional
        Rows of real recordings (real.row).
    suite : mapping, optional
        The section `proof` of the configuration; None: not known, and no entry of the record can be made of it.
    entries : sequence of SeedResult, optional
        Of the record of the proof.
    """
    found = {
        "suite": dict(suite or {}),
        "record": record.summary(entries),
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
    """How many cases there are: in all, by category, kind and phantom, and of one effect by strength."""
    singles = _of(cases, "single")
    return {
        "cases": len(cases),
        "by_category": {name: len(_of(cases, name)) for name in CATEGORIES},
        "by_kind": {kind: sum(case.kind == kind for case in cases) for kind in KINDS},
        "by_phantom": dict(sorted(Counter(case.truth["phantom"] for case in cases).items())),
        "single_by_strength": {name: sum(case.strength == name for case in singles) for name in STRENGTHS},
    }


def effects(cases: Sequence[Case]) -> dict:
    """How many effects the library has, which the suite can and does conceal, and whose models make the recordings.

    Returns
    -------
    dict
        Among the rest, models, {model: {concealed, lacking}}: names of the effects that this suite conceals, those that
        the library has and those that it lacks.
    """
    concealed = sorted({effect for case in cases for effect in case.concealed})
    return {
        "meaning": MEANING["models"],
        "library": len(names()),
        "can_be_concealed": sum(one.known for one in CATALOGUE.values()),
        "never_concealed": never_concealed(),
        "models": {
            model: {
                "concealed": [name for name in concealed if name in made and name in names()],
                "lacking": [name for name in concealed if name in made and name not in names()],
            }
            for model, made in MODELS.items()
        },
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
        "unknown": share(case.owned_up for case in _of(cases, "unknown")),
        "located": share(case.located for case in stated),
        "domains_never_tested": sorted({domain for case in stated for domain in case.truth["where"]} - tested),
    }


def excess_removed(cases: Sequence[Case]) -> dict:
    """How much the named effects remove and what they leave, by group of cases.

    Returns
    -------
    dict
        Beside its meanings

        * in_library: one or two effects of the library; projections and images are the same by kind
        * lacking: an effect that the library lacks
        * right: something concealed, precisely that named
        * wrong: something named that was not concealed, whatever the case
    """
    known = [case for case in cases if case.category in ("single", "pair")]
    groups = {
        "in_library": known,
        **{kind: [case for case in known if case.kind == kind] for kind in KINDS},
        "lacking": _of(cases, "unknown"),
        "right": [case for case in cases if case.concealed and case.exact],
        "wrong": [case for case in cases if set(case.named) - set(case.concealed)],
    }
    meaning = {"meaning": MEANING["excess_removed"], "meaning_of_remainder": MEANING["remainder_sd"]}
    return meaning | {name: _removed(group) for name, group in groups.items()}


def _removed(cases: Sequence[Case]) -> dict:
    values = [case.diagnosis["excess_removed"] for case in cases]
    counted = [value or 0.0 for value in values]
    left = [case.diagnosis["remainder_sd"] for case in cases]
    return {
        "n": len(values),
        "counted_as_0": values.count(None),
        "median": median(counted),
        "median_where_named": median(values),
        "tenth_percentile": quantile(counted, 0.1),
        "remainder_sd": {
            "median": median(left),
            "ninetieth_percentile": quantile(left, 0.9),
            "most": quantile(left, 1),
        },
    }


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
        "remainder_sd": case.diagnosis["remainder_sd"],
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
        "by_model": {
            model: share(right(case) for case in singles if case.concealed[0] in made) for model, made in MODELS.items()
        },
    }
