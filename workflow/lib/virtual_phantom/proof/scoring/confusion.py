"""Confusion matrix of the hidden effect and the effect named first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from ..hiding.case import Case
from ..hiding.hidden_effect import STRENGTHS

NOTHING = "nothing"  # row: nothing hidden; column: a match
NOTHING_FITS = "no effect fits"  # column: a difference without a named effect
NOT_IN_LIBRARY = "{} (not in library)"
# `alternative`: the hidden effect was reported as an alternative to the effect named first.
OUTCOMES = ("right", "alternative", "wrong")  # keys in score.json
MEANING = (
    "The matrix shows cases that hide one effect of the library, one effect that the library lacks, or nothing. Cases "
    "that hide two effects are not in the matrix. Right means that the hidden effect was named first. If nothing is "
    "hidden, it means that the verdict is a match. If the library lacks the effect, it means that the difference was "
    "reported as unexplained. Alternative means that the hidden effect was reported to explain the data as well as "
    "the effect named first."
)


def row_of(case: Case) -> str:
    """Return the row of a case in the matrix."""
    if case.category == "none":
        return NOTHING
    if case.category == "single":
        return case.hidden[0]
    not_in_library = [effect["name"] for effect in case.truth["effects"] if not effect["known"]]
    return NOT_IN_LIBRARY.format(" + ".join(not_in_library))


def column_of(case: Case) -> str:
    """Return the column of a case in the matrix."""
    return case.first or (NOTHING if case.match else NOTHING_FITS)


def outcome(case: Case) -> str:
    """Return one of OUTCOMES."""
    if case.right:
        return "right"
    return "alternative" if case.category == "single" and case.first_or_alternative_right else "wrong"


def matrix(cases: Sequence[Case]) -> dict:
    """Count cases by row, column and strength.

    Returns
    -------
    dict
        Meaning, number of pairs_left_out, and

        * rows: hidden effects of the library, NOTHING, and effects that the library lacks
        * columns: hidden or named effects of the library, NOTHING, and NOTHING_FITS
        * counts: [row][column]
        * cells: nonzero cells with row, column, strength (or None), count and outcomes
    """
    shown = [case for case in cases if case.category != "pair"]
    placed = [(row_of(case), column_of(case), case) for case in shown]
    in_library = {row for row, _, case in placed if case.category == "single"}
    not_in_library = sorted({row for row, _, case in placed if case.category == "unknown"})
    named = {case.first for case in shown if case.first}
    columns = [*sorted(in_library | named), NOTHING, NOTHING_FITS]
    rows = [*sorted(in_library), NOTHING, *not_in_library]
    groups = Counter((row, column, case.strength, outcome(case)) for row, column, case in placed)
    cells = []
    for row in rows:
        for column in columns:
            for strength in (*STRENGTHS, None):
                counts = {outcome_name: groups[row, column, strength, outcome_name] for outcome_name in OUTCOMES}
                if total := sum(counts.values()):
                    cells.append(
                        {"row": row, "column": column, "strength": strength, "count": total, "outcomes": counts}
                    )
    totals = Counter((row, column) for row, column, _ in placed)
    return {
        "meaning": MEANING,
        "rows": rows,
        "columns": columns,
        "counts": [[totals[row, column] for column in columns] for row in rows],
        "cells": cells,
        "pairs_left_out": len(cases) - len(shown),
    }
