"""Compare the score of the blind validation with its targets."""

from __future__ import annotations

from collections.abc import Mapping

from ...base.names import label
from ...statistics.proof_record import QUANTITIES
from .agreement import TARGETS as AGREEMENT_TARGETS

MINUTES = 180.0  # wall time of the whole suite on two cores
EXCESS_REMOVED = 0.85  # median share of the RMS
# {quantity: target and its sense}
TARGETS = {
    "first_medium_or_strong": (0.93, "at least"),
    "first_weak": (0.7, "at least"),
    "exact": (0.85, "at least"),
    "pairs": (0.8, "at least"),
    "false_alarms": (0.05, "at most"),
    "false_alarms_undeclared": (0.05, "at most"),
    "unknown": (0.88, "at least"),
    "intervals": (0.9, "at least"),
}


def targets(score: Mapping, minutes: float | None = None) -> list[dict]:
    """Compare the score with the targets of the blind validation.

    Parameters
    ----------
    score : mapping
        Numbers that score.score has computed so far.
    minutes : float, optional
        Wall time of the scans and diagnoses on two cores; None if it was not measured.

    Returns
    -------
    list of dict
        {name, what, value, target, sense, unit, n, ci95, reached}. value and reached are None without a measurement.
    """
    counted = score["headline"]["all"]
    found = [_share(name, QUANTITIES[name], counted[name], *limit) for name, limit in TARGETS.items()]
    removed = score["excess_removed"]["in_library"]
    what = "held-out excess RMS removed, median"
    found.append(_target("excess_removed", what, removed["median"], EXCESS_REMOVED, n=removed["n"]))
    for metric, limit in AGREEMENT_TARGETS.items():
        entry = score["agreement"]["metrics"][metric]
        what = f"{label(metric)} on the held-out protocol, median difference after the fit"
        found.append(_target(metric, what, entry["after"], limit, "at most", n=entry["n"]))
    found.append(_target("minutes", "scans and diagnoses on two cores", minutes, MINUTES, "at most", unit="minutes"))
    return found


def _share(name: str, what: str, share: Mapping, target: float, sense: str) -> dict:
    return _target(name, what, share["share"], target, sense, n=share["n"]) | {"ci95": share["ci95"]}


def _target(name, what, value, target, sense="at least", unit="share", n=None) -> dict:
    reached = None
    if value is not None:
        reached = bool(value >= target if sense == "at least" else value <= target)
    entry = {"name": name, "what": what, "value": value, "target": target, "sense": sense, "unit": unit, "n": n}
    return entry | {"ci95": None, "reached": reached}
