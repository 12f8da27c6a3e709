"""What was concealed against what was named first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from ..hiding.case import MATCH, Case
from ..hiding.catalogue import STRENGTHS

NOTHING = "nothing"  # row: nothing concealed; column: a match
NOTHING_FITS = "no effect fits"  # column: a difference, and no effect named
NOT_IN_LIBRARY = "{} (not in library)"
OUTCOMES = ("right", "stand-in", "wrong")
MEANING = (
    "Cases with one concealed effect, one that the library lacks, or nothing; cases with two are not in the matrix. "
    "Right: the concealed effect named first; nothing concealed and a match; of effects that the library lacks, that "
    "something is left unexplained. Stand-in: the concealed effect is reported to explain the data as well as the one "
    "named first."
)


def row_of(case: Case) -> str:
    """The matrix's row of a case."""
    if case.category == "none":
        return NOTHING
    if case.category == "single":
        return case.concealed[0]
    missing = [effect["name"] for effect in case.truth["effects"] if not effect["known"]]
    return NOT_IN_LIBRARY.format(" + ".join(missing))


def column_of(case: Case) -> str:
    """The matrix's column of a case."""
    return case.first or (NOTHING if case.verdict == MATCH else NOTHING_FITS)


def outcome(case: Case) -> str:
    """One of OUTCOMES."""
    if case.right:
        return "right"
    return "stand-in" if case.category == "single" and case.first_or_stand_in_right else "wrong"


def matrix(cases: Sequence[Case]) -> dict:
    """Counts by row, column and strength.

    Returns
    -------
    dict
        Beside its meaning and the number of pairs_left_out

        * rows, columns: names, effects of the library, in one order, then nothing; then rows of effects that the
          library lacks, and the column of differences without a name
        * counts: [row][column]
        * cells: those that are not empty, by row, column, strength (None where there is none), count, outcomes
    """
    taken = [case for case in cases if case.category != "pair"]
    placed = [(row_of(case), column_of(case), case) for case in taken]
    in_library = {row for row, _, case in placed if case.category == "single"}
    missing = sorted({row for row, _, case in placed if case.category == "unknown"})
    named = {case.first for case in taken if case.first}
    columns = [*sorted(in_library | named), NOTHING, NOTHING_FITS]
    rows = [*sorted(in_library), NOTHING, *missing]
    groups = Counter((row, column, case.strength, outcome(case)) for row, column, case in placed)
    cells = []
    for row in rows:
        for column in columns:
            for strength in (*STRENGTHS, None):
                counts = {one: groups[row, column, strength, one] for one in OUTCOMES}
                if total := sum(counts.values()):
                    cells.append(
                        {"row": row, "column": column, "strength": strength, "count": total, "outcomes": counts}
                    )
    counts = [
        [sum(cell["count"] for cell in cells if (cell["row"], cell["column"]) == (row, column)) for column in columns]
        for row in rows
    ]
    return {
        "meaning": MEANING,
        "rows": rows,
        "columns": columns,
        "counts": counts,
        "cells": cells,
        "pairs_left_out": len(cases) - len(taken),
    }
