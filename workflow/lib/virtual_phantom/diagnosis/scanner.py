"""A scanner's diagnosis: several recordings, one physics, judged by the recordings that were not fitted."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.words import label
from ..physics.effect import OF_PROTOCOL, OF_SCANNER, load
from ..statistics.multiplicity import bonferroni
from .core.fit import Fit
from .core.inexact import errors_of_recordings
from .core.joint import NOT_OF_SCAN, JointFit, JointFitter, those
from .core.joint_choice import JointChoice, choose_jointly
from .core.locate import ALPHA, aligned
from .core.prepared import Prepared
from .core.pulls import statements
from .core.sentence import misstated
from .core.steps import interval
from .core.verdict import VERDICTS, excess_rms_removed


@dataclass(frozen=True)
class ScannerDiagnosis:
    """Everything that is reported.

    Attributes
    ----------
    choice : JointChoice
    content : dict
        What scanner.json holds.
    """

    choice: JointChoice
    content: dict


def protocols_of(prepared: Mapping[str, Prepared], stated: Mapping[str, Sequence[str]] | None = None) -> dict[str, str]:
    """The protocol of each recording.

    Parameters
    ----------
    prepared : mapping of str to Prepared
        By recording.
    stated : mapping of str to sequence of str, optional
        {protocol: its recordings}. The others are of one protocol for each tube voltage that they state.

    Returns
    -------
    dict of str to str
        {recording: protocol}; all "" where there is but one.
    """
    found = {recording: protocol for protocol, recordings in (stated or {}).items() for recording in recordings}
    for name, one in prepared.items():
        kvp = one.fitter.model.tube_kvp
        found.setdefault(name, "voltage not stated" if kvp is None else f"{kvp:g} kV")
    return found if len(set(found.values())) > 1 else dict.fromkeys(found, "")


def scanned_in(settings: Mapping) -> str:
    """What a recording's settings say was scanned, for comparison with others."""
    return json.dumps([settings.get("disc"), settings.get("object")], sort_keys=True)


def explain_scanner(
    name: str,
    prepared: Mapping[str, Prepared],
    candidates: Sequence[str],
    accuracy: Mapping[str, float],
    protocols: Mapping[str, Sequence[str]] | None = None,
    objects: Mapping[str, str] | None = None,
) -> ScannerDiagnosis:
    """Choose the effects that explain recordings together, and judge them on each by the physics of the others.

    Parameters
    ----------
    name : str
        Of the scanner.
    prepared : mapping of str to Prepared
        By recording.
    candidates : sequence of str
    accuracy : mapping of str to float
        As core.attribute.choose takes it.
    protocols : mapping of str to sequence of str, optional
        As protocols_of takes them.
    objects : mapping of str to str, optional
        What each recording is of: those of one object are left out together.

    Returns
    -------
    ScannerDiagnosis

    Raises
    ------
    InputError
        As choose_jointly.
    """
    together = JointFitter({key: one.fitter for key, one in prepared.items()}, protocols_of(prepared, protocols))
    choice = choose_jointly(together, candidates, accuracy, objects)
    chosen = choice.chosen
    errors: Mapping[str, Mapping] = {}
    if together.whole(chosen.effects):
        errors = errors_of_recordings(together, chosen, choice.without, accuracy)
    known, of_protocols = _declared(together, chosen, errors)
    off = any(
        one["off"] for every in (known, *of_protocols.values()) for keys in every.values() for one in keys.values()
    )
    recordings = {
        key: {"protocol": together.protocols[key]} | _recording(one, choice, key) for key, one in prepared.items()
    }
    removed = [one["excess_rms_removed"] for one in recordings.values() if one["excess_rms_removed"] is not None]
    left = [key for key, one in recordings.items() if one["unexplained"]]
    content = {
        "scanner": name,
        "verdict": VERDICTS[(2 if left else 1) if chosen.effects or off else (3 if left else 0)],
        "effects": [_effect(effect, choice, together.protocols, errors) for effect in chosen.effects],
        "declared": known,
        "declared_of_protocols": of_protocols,
        "recordings": recordings,
        "excess_rms_removed": {"median": float(np.median(removed)), "worst": float(np.min(removed))}
        if removed and chosen.effects
        else None,
        "effects_tried": list(candidates),
    }
    return ScannerDiagnosis(choice, content | {"sentence": sentence(content)})


def sentence(content: Mapping) -> str:
    """The verdict in words.

    Parameters
    ----------
    content : mapping
        What scanner.json holds, but for the sentence itself.

    Returns
    -------
    str
    """
    count = len(content["recordings"])
    left = [name for name, one in content["recordings"].items() if one["unexplained"]]
    rest = f" Places that differ are left on {', '.join(left)}." if left else ""
    of_protocols = (
        misstated({"declared": one}, f" of protocol {key}") for key, one in content["declared_of_protocols"].items()
    )
    rest = misstated(content) + "".join(of_protocols) + rest
    if not content["effects"]:
        what = "differ, and no effect that they share explains it" if left else "agree"
        return f"{content['scanner']}: {count} recordings and the simulation {what}.{rest}"
    names = " and ".join(label(one["name"]) for one in content["effects"])
    removed = content["excess_rms_removed"]
    share = ""
    if removed is not None:
        median, worst = (round(100 * removed[key]) for key in ("median", "worst"))
        share = (
            f" Fitted to the others, it removes {median} % (median; at worst {worst} %) of the root mean square beyond "
            "noise of a recording."
        )
    return f"{content['scanner']}: {count} recordings share what the simulation lacks: {names}.{share}{rest}"


def _declared(
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


def _effect(name: str, choice: JointChoice, protocols: Mapping[str, str], errors: Mapping[str, Mapping]) -> dict:
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
            "ci95": interval(value, errors[recordings[0]][name].get(key, 0.0), low, high),
            "ci95_noise": interval(value, fit.errors[name].get(key, 0.0), low, high),
            "unit": stated[key].unit,
            "without": {
                one: other.physics[name][key] for one, other in without.items() if key in other.elsewhere.get(name, ())
            },
        }
    return parameters


def _recording(prepared: Prepared, choice: JointChoice, name: str) -> dict:
    """What the physics of the other recordings makes of one, on its data held out."""
    fit, before = choice.left_out[name], choice.baseline.fits[name]
    rms = {
        key: float(np.sqrt((prepared.difference(one, held_out=True) ** 2).mean()))
        for key, one in (("before", before), ("after", fit))
    }
    data = prepared.held_out
    rms["floor"] = float(np.sqrt((prepared.variance[data.usable] / data.n).mean()))
    fitted, held = prepared.halves(fit)
    places = prepared.domains(held, fit, fitted, aligned(fit, prepared.fitter.model.distortions))
    # Over all recordings together: of many, one would stand out by chance.
    left = [one for one in places if bonferroni(one.p, len(choice.left_out)) < ALPHA]
    return {
        f"rms_{prepared.look.unit}": rms,
        "excess_rms_removed": excess_rms_removed(**rms),
        "log_score": choice.scores[name],
        "unexplained": [{"domain": one.domain, "where": one.where, "z": one.z} for one in left],
        "alignment": fit.nuisance,
        "own": _own(fit),
    }


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
