"""Compare the score of the blind validation with its targets."""

from __future__ import annotations

from collections.abc import Mapping

from ...base.names import label
from .agreement import TARGETS as AGREEMENT_TARGETS

MINUTES = 90.0  # wall time of the whole suite on two cores


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
    accuracy = score["accuracy"]
    stronger = accuracy["first"]["medium_or_strong"]
    found = [
        _share("first", "named first, one effect of medium or strong strength", stronger, 0.9),
        _share("pairs", "both of two effects named", accuracy["pairs"]["both_named"], 0.75),
        _share("false_alarms", "false alarms if nothing is hidden", accuracy["false_alarms"], 0.05, "at most"),
        _share("unknown", "reported as unexplained if the library lacks the effect", accuracy["unknown"], 0.8),
    ]
    removed = score["excess_removed"]["in_library"]
    found.append(_target("excess_removed", "held-out excess removed, median", removed["median"], 0.85, n=removed["n"]))
    for metric, limit in AGREEMENT_TARGETS.items():
        entry = score["agreement"]["metrics"][metric]
        what = f"{label(metric)} on the held-out protocol, median difference after the fit"
        found.append(_target(metric, what, entry["after"], limit, "at most", n=entry["n"]))
    found.append(_target("minutes", "scans and diagnoses on two cores", minutes, MINUTES, "at most", unit="minutes"))
    return found


def _share(name: str, what: str, share: Mapping, target: float, sense: str = "at least") -> dict:
    return _target(name, what, share["share"], target, sense, n=share["n"]) | {"ci95": share["ci95"]}


def _target(name, what, value, target, sense="at least", unit="share", n=None) -> dict:
    reached = None
    if value is not None:
        reached = bool(value >= target if sense == "at least" else value <= target)
    entry = {"name": name, "what": what, "value": value, "target": target, "sense": sense, "unit": unit, "n": n}
    return entry | {"ci95": None, "reached": reached}
