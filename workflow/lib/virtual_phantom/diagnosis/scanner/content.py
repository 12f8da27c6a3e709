"""What is told of a scanner: the parts of scanner.json, and its verdict in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from ...base.words import label
from ...physics.effect import OF_PROTOCOL, OF_SCAN, OF_SCANNER, load
from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.joint_fit import NOT_OF_SCAN, JointFit, JointFitter, those
from ..fitting.steps import interval
from ..residuals.dataset import Prepared
from ..residuals.residual_tests import ALPHA, aligned
from ..selection.joint_selection import JointChoice
from ..uncertainty.intervals import intervals
from ..verdict.pulls import statements
from ..verdict.verdict import excess_rms_removed
from ..wording import misstated
from .consistency import Alone


def sentence(content: Mapping) -> str:
    """The verdict in words.

    Parameters
    ----------
    content : mapping
        What scanner.json holds, but for the sentence itself.
    """
    recordings = content["recordings"]
    left = [name for name, one in recordings.items() if one["unexplained"]]
    of_protocols = (
        misstated({"declared": one}, f" of protocol {key}") for key, one in content["declared_of_protocols"].items()
    )
    apart = _apart(recordings)
    rest = misstated(content) + "".join(of_protocols) + apart
    rest += f" Places that differ are left on {', '.join(left)}." if left else ""
    if not content["effects"]:
        what = "differ, and no effect that they share explains it" if left or apart else "agree"
        return f"{content['scanner']}: {len(recordings)} recordings and the simulation {what}.{rest}"
    judged = [name for name, one in recordings.items() if one["judged"]]
    names = " and ".join(label(one["name"]) for one in content["effects"])
    found = (
        f"{content['scanner']}: {len(recordings) - len(judged)} recordings share what the simulation lacks: {names}."
    )
    if content["excess_rms_removed"] is not None:
        share = _shares(content["excess_rms_removed"])
        found += f" Fitted to the others, it removes {share} of the root mean square beyond noise of a recording."
    if content["excess_rms_removed_judged"] is not None:
        share = _shares(content["excess_rms_removed_judged"])
        found += f" On {', '.join(judged)}, which had no part in that, it removes {share}."
    return found + rest


def _shares(removed: Mapping[str, float]) -> str:
    median, worst = (round(100 * removed[key]) for key in ("median", "worst"))
    return f"{median} % (median; at worst {worst} %)"


def _apart(recordings: Mapping[str, Mapping]) -> str:
    """Which recordings disagree with the others."""
    fitted = [name for name, one in recordings.items() if not one["judged"]]
    off = [name for name, one in recordings.items() if one["agreement"] and one["agreement"]["disagrees"]]
    odd = [name for name in off if name in fitted]
    words = ""
    if 2 * len(odd) > len(fitted):  # none of them is the odd one out
        words = f" By more than noise and inexact models make up, {', '.join(fitted)} disagree with each other."
        off = [name for name in off if name not in fitted]
    if off:
        others = recordings[off[0]]["agreement"]["against"]
        words += (
            f" On what they share, {', '.join(off)} disagree{'s' if len(off) == 1 else ''} with {', '.join(others)}: "
            "another day, another setting?"
        )
    return words


def declared_content(
    together: JointFitter, chosen: JointFit, errors: Mapping[str, Mapping]
) -> tuple[dict[str, dict], dict[str, dict]]:
    """How statements on the scanner fared, and by protocol those on what is its own, where there are several."""
    firsts: dict[str, str] = {}
    for recording, protocol in together.protocols.items():
        firsts.setdefault(protocol, recording)

    def of(recording: str, owners: Sequence[str]) -> dict[str, dict]:
        known = statements(chosen.fits[recording], together.fitters[recording].model, errors.get(recording))
        found = {name: those(owners, name, parameters) for name, parameters in known.items()}
        return {name: parameters for name, parameters in found.items() if parameters}

    several = len(firsts) > 1
    known = of(next(iter(together.fitters)), (OF_SCANNER,) if several else NOT_OF_SCAN)
    return known, {key: of(one, (OF_PROTOCOL,)) for key, one in firsts.items()} if several else {}


def effect_content(name: str, choice: JointChoice, protocols: Mapping[str, str], errors: Mapping[str, Mapping]) -> dict:
    """What is said of an effect, with its standard errors, inexact models included, by recording."""
    effect = load(name)
    members: dict[str, list[str]] = {}
    for recording, protocol in protocols.items():
        members.setdefault(protocol, []).append(recording)
    several = len(members) > 1
    parameters = _parameters(name, (OF_SCANNER,) if several else NOT_OF_SCAN, list(protocols), choice, errors)
    own = {
        protocol: _parameters(name, (OF_PROTOCOL,), recordings, choice, errors)
        for protocol, recordings in members.items()
        if several
    }
    return {
        "name": name,
        "physics": effect.physics,
        "parameters": parameters,
        "protocols": own if all(own.values()) else {},
        "evidence": {"left_out_gain": choice.gains[name], "p": choice.p[name]},
    }


def _parameters(
    name: str, owners: Sequence[str], recordings: Sequence[str], choice: JointChoice, errors: Mapping[str, Mapping]
) -> dict:
    """Parameters of an effect that recordings have in common: values, intervals, and what the others say of each."""
    stated, fit = {one.name: one for one in load(name).parameters}, choice.chosen.fits[recordings[0]]
    parameters = {}
    for key, value in those(owners, name, fit.physics[name]).items():
        low, high = stated[key].low, stated[key].high
        without = {one: choice.left_out[one] for one in recordings}
        parameters[key] = {
            "value": value,
            **intervals(value, fit.errors[name].get(key, 0.0), errors[recordings[0]][name].get(key, 0.0), low, high),
            "unit": stated[key].unit,
            "without": {
                one: other.physics[name][key] for one, other in without.items() if key in other.elsewhere.get(name, ())
            },
        }
    return parameters


def recording_content(prepared: Prepared, before: Fit, fit: Fit, log_score: Mapping[str, float], compared: int) -> dict:
    """What the physics of the other recordings makes of one, on its data held out.

    Parameters
    ----------
    before, fit : Fit
        Without the chosen effects, and with them.
    log_score : mapping of str to float
        On its data held out, "before" and "after".
    compared : int
        Number of recordings.
    """
    rms = {
        key: float(np.sqrt((prepared.difference(one, held_out=True) ** 2).mean()))
        for key, one in (("before", before), ("after", fit))
    }
    data = prepared.held_out
    rms["floor"] = float(np.sqrt((prepared.variance[data.usable] / data.n).mean()))
    fitted, held = prepared.halves(fit)
    places = prepared.domains(held, fit, fitted, aligned(fit, prepared.fitter.model.distortions))
    # Over all recordings together: of many, one would stand out by chance.
    left = [one for one in places if bonferroni(one.p, compared) < ALPHA]
    return {
        f"rms_{prepared.look.unit}": rms,
        "excess_rms_removed": excess_rms_removed(**rms),
        "log_score": dict(log_score),
        "unexplained": [{"domain": one.domain, "where": one.where, "z": one.z} for one in left],
        "alignment": fit.nuisance,
        "own": _own(fit),
    }


def alone_content(found: Alone | None) -> dict:
    """What a recording says alone, and whether that agrees with the others.

    Parameters
    ----------
    found : Alone or None
        None: recordings share no number.
    """
    if found is None:
        return {"alone": {}, "agreement": None}
    said: dict[str, dict[str, dict]] = {}
    for name, values in found.fit.physics.items():
        for one in load(name).parameters:
            if (error := found.errors[name].get(one.name)) is not None and one.belongs_to != OF_SCAN:
                value = values[one.name]
                ends = interval(value, error, one.low, one.high)
                said.setdefault(name, {})[one.name] = {"value": value, "ci95": ends}
    apart = found.difference
    told = asdict(apart) | {"against": list(apart.against), "disagrees": apart.disagrees}
    return {"alone": said, "agreement": told}


def removed(recordings: Mapping[str, Mapping], judged: bool) -> dict | None:
    """Share of the root mean square beyond noise that is removed, over the recordings.

    Parameters
    ----------
    recordings : mapping of str to mapping
        As in scanner.json.
    judged : bool
        Of those that were not fitted; False: of the others.

    Returns
    -------
    dict or None
        {"median", "worst"}; None where there is none.
    """
    every = [one["excess_rms_removed"] for one in recordings.values() if one["judged"] == judged]
    shares = [share for share in every if share is not None]
    return {"median": float(np.median(shares)), "worst": float(np.min(shares))} if shares else None


def _own(fit: Fit) -> dict:
    """Parameters that other recordings say nothing of, as {effect: {parameter: value}}."""
    own = {
        name: {
            one.name: fit.physics[name][one.name]
            for one in load(name).parameters
            if one.belongs_to != OF_SCANNER and one.name not in fit.elsewhere.get(name, ())
        }
        for name in fit.effects
    }
    return {name: values for name, values in own.items() if values}
