"""Agreement in images on a protocol that nothing was fitted to, beside that of a published simulator."""

from __future__ import annotations

from collections.abc import Sequence

from ..hiding.case import Case
from .intervals import median

# Of |simulated / recorded - 1|, as the work is held to them.
TARGETS = {"contrast": 0.014, "noise_magnitude": 0.02, "noise_texture": 0.026, "resolution": 0.03}
# DukeSim against a real scanner: E. Abadi et al., IEEE Trans. Med. Imaging 38, 1457 (2019).
DUKESIM = {"contrast": 0.014, "noise_magnitude": 0.005, "noise_texture": 0.026, "resolution": 0.03}
METRICS = (*TARGETS, "noise_spectrum", "features")
MEANING = (
    "Cases with one effect of the library; the physics found is held against a second scan by another protocol, where "
    "only the alignment is fitted. Medians over cases of |simulated / recorded - 1|, before (alignment alone) and "
    "after; floor: the standard error that noise leaves it. Of features the share within one repeat SD, and the share "
    "that is expected where nothing but noise differs."
)


def summary(cases: Sequence[Case]) -> dict:
    """Medians over cases with one concealed effect of the library.

    Returns
    -------
    dict
        Beside its meaning and the number of cases

        * metrics: {metric: {n, before, after, floor, target, dukesim}}, those of |relative difference|, of features the
          shares; None where there are none
        * by_phantom: {phantom: {metric: {n, before, after, floor}}}
        * missing: cases without any number on another protocol
    """
    singles = [case for case in cases if case.category == "single"]
    phantoms = sorted({case.truth["phantom"] for case in singles})
    of = {name: [case for case in singles if case.truth["phantom"] == name] for name in phantoms}
    limits = {metric: {"target": TARGETS.get(metric), "dukesim": DUKESIM.get(metric)} for metric in METRICS}
    return {
        "meaning": MEANING,
        "metrics": {metric: medians(singles, metric) | limits[metric] for metric in METRICS},
        "by_phantom": {name: {metric: medians(own, metric) for metric in METRICS} for name, own in of.items()},
        "cases": len(singles),
        "missing": [case.name for case in singles if not case.other],
    }


def medians(cases: Sequence[Case], metric: str) -> dict:
    """How many cases have a metric, and its medians before, after and of noise alone."""
    entries = [case.other[metric] for case in cases if case.other and metric in case.other]
    return {
        "n": len(entries),
        "before": median(_size(entry["before"]) for entry in entries),
        "after": median(_size(entry["after"]) for entry in entries),
        "floor": median(entry["floor"] for entry in entries),
    }


def _size(column: dict) -> float:
    """|relative difference|, or the value of a metric that is itself a share."""
    relative = column["relative_difference"]
    return column["value"] if relative is None else abs(relative)
