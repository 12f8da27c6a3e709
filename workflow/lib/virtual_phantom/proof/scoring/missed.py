"""Reasons for wrong answers, from the numbers of the diagnosis."""

from __future__ import annotations

from ...base.names import label
from ...diagnosis.selection.forward_selection import AS_GOOD, RULED_OUT
from ...diagnosis.verdict_text import SETUP_VERDICTS, UNEXPLAINED
from ...figures.style import number
from ..hiding.case import Case


def why(case: Case) -> list[str]:
    """Explain why the answer of a case is wrong; an empty list if it is right."""
    if case.right:
        return []
    if case.diagnosis["verdict"] in SETUP_VERDICTS.values():
        return ["The diagnosis reported a scan set-up error or another object, so that no effect was fitted."]
    if case.category == "none":
        worst = case.diagnosis["locations"][0]
        return [
            "A difference between the two simulators, or noise, was mistaken for physics. It was most significant in "
            f"{worst['domain']} ({worst['where']})."
        ]
    if case.match:
        return ["Too little signal: with alignment alone, no difference on data not fitted is significant."]
    if case.category == "unknown":
        names = " and ".join(label(name) for name in case.named)
        return [f"On data not fitted, {names} explains the whole difference: no significant difference is left."]
    if case.diagnosis["verdict"] == UNEXPLAINED:
        return [
            "A difference was detected, but no effect improved the log score on data not fitted enough to be named."
        ]
    enough = {case.first} if case.category == "single" else set(case.named)
    return [_not_named(effect, case) for effect in case.hidden if effect not in enough]


def _not_named(effect: str, case: Case) -> str:
    """Explain why a hidden effect was not named (first)."""
    name = label(effect)
    name = name[:1].upper() + name[1:]
    if effect in case.named:
        return f"{name} was named, but not first."
    hosts = [named for named in case.named if effect in case.with_alternatives(named)]
    if hosts:
        return (
            f"{name} was reported as an alternative to {label(hosts[0])}: it lowers the log score by less than "
            f"{AS_GOOD:g}."
        )
    improvement = case.diagnosis.get("undecided", {}).get(effect)
    if improvement is not None:
        return (
            f"{name} was left undecided: the expected improvement in log score is {number(improvement)}, which an "
            "inexact model of the named effects could also cause."
        )
    lost = case.diagnosis["ruled_out"].get(effect)
    if lost is not None:
        return (
            f"{name} was ruled out: as a replacement, it would lower the log score by at least "
            f"{number(lost)}. In the recording, it resembles the library's model of another effect."
        )
    return (
        f"{name} was neither named nor ruled out: as a replacement, it lowers the log score by less than "
        f"{RULED_OUT:g}, or it was not a candidate."
    )
