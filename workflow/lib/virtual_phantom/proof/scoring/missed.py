"""Cases that were not answered rightly: what was concealed, what was said, and why, by the diagnosis' numbers."""

from __future__ import annotations

from ...base.names import label
from ...diagnosis.selection.forward_selection import AS_GOOD, RULED_OUT
from ...figures.style import number
from ..hiding.case import MATCH, UNEXPLAINED, Case


def why(case: Case) -> list[str]:
    """Sentences on a case that is not right; none of one that is."""
    if case.right:
        return []
    if case.category == "none":
        worst = case.diagnosis["locations"][0]
        return [
            "A difference between the two simulators, or noise, was taken for physics. It stood out most in "
            f"{worst['domain']} ({worst['where']})."
        ]
    if case.verdict == MATCH:
        return ["Too little signal: with alignment alone, nothing stands out of the noise on data not fitted."]
    if case.category == "unknown":
        names = " and ".join(label(name) for name in case.named)
        return [f"On data not fitted, nothing significant is left beside {names}: it takes up the whole difference."]
    if case.verdict == UNEXPLAINED:
        return ["A difference was seen, but no effect gained enough on data not fitted to be named."]
    enough = {case.first} if case.category == "single" else set(case.named)
    return [_of(effect, case) for effect in case.concealed if effect not in enough]


def _of(effect: str, case: Case) -> str:
    """Why one concealed effect was not named (first)."""
    name = label(effect)
    name = name[:1].upper() + name[1:]
    if effect in case.named:
        return f"{name} was named, but not first."
    hosts = [named for named in case.named if effect in case.with_stand_ins(named)]
    if hosts:
        return (
            f"{name} was reported as a stand-in of {label(hosts[0])}: in its place it loses less than {AS_GOOD:g} of "
            "log score."
        )
    promised = case.diagnosis.get("undecided", {}).get(effect)
    if promised is not None:
        return (
            f"{name} was left undecided: beside what was named it promised {number(promised)} of log score, as much as "
            "an inexact model of that might leave."
        )
    lost = case.diagnosis["ruled_out"].get(effect)
    if lost is not None:
        return (
            f"{name} was ruled out: in its best place it would lose {number(lost)} of log score. What was recorded of "
            "it is nearer to the library's model of something else."
        )
    return (
        f"{name} was neither named nor ruled out: in its best place it loses under {RULED_OUT:g} of log score, or it "
        "was not among the candidates."
    )
