"""Agreement of simulated and recorded images for a protocol that was not fitted.

The table also shows the published agreement of another simulator (DukeSim) with a real scanner.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..hiding.case import Case
from .intervals import median

# Largest acceptable |simulated / recorded - 1|.
TARGETS = {"contrast": 0.014, "noise_magnitude": 0.02, "noise_texture": 0.026, "resolution": 0.03}
# DukeSim compared with a real scanner: E. Abadi et al., IEEE Trans. Med. Imaging 38, 1457 (2019).
DUKESIM = {"contrast": 0.014, "noise_magnitude": 0.005, "noise_texture": 0.026, "resolution": 0.03}
METRICS = (*TARGETS, "noise_spectrum", "features")
MEANING = (
    "Cases with one effect of the library. The physics found is compared with a second scan by another protocol, where "
    "only the alignment is fitted. Medians over cases of |simulated / recorded - 1|, before (alignment alone) and "
    "after. Floor: standard error due to noise. For features: share within one repeat SD, and the share that is "
    "expected if only noise differs."
)


def summary(cases: Sequence[Case]) -> dict:
    """Return medians over cases with one hidden effect of the library.

    Returns
    -------
    dict
        Meaning and number of cases, and

        * metrics: {metric: {n, before, after, floor, target, dukesim}}, medians of |relative difference|, for features
          the share; None without a value
        * by_phantom: {phantom: {metric: {n, before, after, floor}}}
        * missing: cases without any metric on another protocol
    """
    singles = [case for case in cases if case.category == "single"]
    phantoms = sorted({case.truth["phantom"] for case in singles})
    cases_of = {name: [case for case in singles if case.truth["phantom"] == name] for name in phantoms}
    limits = {metric: {"target": TARGETS.get(metric), "dukesim": DUKESIM.get(metric)} for metric in METRICS}
    return {
        "meaning": MEANING,
        "metrics": {metric: medians(singles, metric) | limits[metric] for metric in METRICS},
        "by_phantom": {
            name: {metric: medians(phantom_cases, metric) for metric in METRICS}
            for name, phantom_cases in cases_of.items()
        },
        "cases": len(singles),
        "missing": [case.name for case in singles if not case.other],
    }


def medians(cases: Sequence[Case], metric: str) -> dict:
    """Return the number of cases with a metric and its medians before, after and for noise alone."""
    entries = [case.other[metric] for case in cases if case.other and metric in case.other]
    return {
        "n": len(entries),
        "before": median(_difference(entry["before"]) for entry in entries),
        "after": median(_difference(entry["after"]) for entry in entries),
        "floor": median(entry["floor"] for entry in entries),
    }


def _difference(column: dict) -> float:
    """Return |relative difference|, or the value of a metric that is itself a share."""
    relative = column["relative_difference"]
    return column["value"] if relative is None else abs(relative)
