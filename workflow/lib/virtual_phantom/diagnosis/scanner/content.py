"""Content of scanner.json: declared physics, effects, and each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from ...physics.effect import OF_PROTOCOL, OF_SCAN, OF_SCANNER, load
from ...statistics.multiplicity import bonferroni
from ..fitting.fit import Fit
from ..fitting.joint_fit import NOT_OF_SCAN, JointFit, JointFitter, parameters_owned_by
from ..fitting.steps import interval
from ..residuals.dataset import Prepared
from ..residuals.residual_tests import ALPHA, alignment_tests
from ..selection.joint_selection import JointChoice
from ..uncertainty.intervals import intervals
from ..verdict.verdict import excess_rms_removed, rms_of
from ..verdict.warnings import statements
from .consistency import Alone


def declared_content(
    together: JointFitter, chosen: JointFit, errors: Mapping[str, Mapping]
) -> tuple[dict[str, dict], dict[str, dict]]:
    """Return declared values with the fitted ones: shared by all recordings, and by protocol if there are several."""
    firsts = {protocol: recordings[0] for protocol, recordings in _members(together.protocols).items()}

    def of(recording: str, owners: Sequence[str]) -> dict[str, dict]:
        known = statements(chosen.fits[recording], together.fitters[recording].model, errors.get(recording))
        found = {name: parameters_owned_by(owners, name, parameters) for name, parameters in known.items()}
        return {name: parameters for name, parameters in found.items() if parameters}

    several = len(firsts) > 1
    shared = of(next(iter(together.fitters)), (OF_SCANNER,) if several else NOT_OF_SCAN)
    return shared, {key: of(first, (OF_PROTOCOL,)) for key, first in firsts.items()} if several else {}


def effect_content(name: str, choice: JointChoice, protocols: Mapping[str, str], errors: Mapping[str, Mapping]) -> dict:
    """Return an effect with parameters and evidence; `errors` are standard errors with model errors, by recording."""
    members = _members(protocols)
    several = len(members) > 1
    own = {
        protocol: _parameters(name, (OF_PROTOCOL,), recordings, choice, errors)
        for protocol, recordings in members.items()
        if several
    }
    return {
        "name": name,
        "physics": load(name).physics,
        "parameters": _parameters(name, (OF_SCANNER,) if several else NOT_OF_SCAN, list(protocols), choice, errors),
        "protocols": own if all(own.values()) else {},
        "evidence": {"left_out_gain": choice.gains[name], "p": choice.p[name]},
    }


def _members(protocols: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the recordings of every protocol."""
    found: dict[str, list[str]] = {}
    for recording, protocol in protocols.items():
        found.setdefault(protocol, []).append(recording)
    return found


def _parameters(
    name: str, owners: Sequence[str], recordings: Sequence[str], choice: JointChoice, errors: Mapping[str, Mapping]
) -> dict:
    """Return the shared parameters of an effect: values, intervals, and values fitted without each recording."""
    ranges = {parameter.name: parameter for parameter in load(name).parameters}
    fit = choice.chosen.fits[recordings[0]]
    parameters = {}
    for key, value in parameters_owned_by(owners, name, fit.physics[name]).items():
        low, high = ranges[key].low, ranges[key].high
        noise, whole = (known[name].get(key, 0.0) for known in (fit.errors, errors[recordings[0]]))
        others = {recording: choice.left_out[recording] for recording in recordings}
        without = {
            recording: other.physics[name][key]
            for recording, other in others.items()
            if key in other.elsewhere.get(name, ())
        }
        found = intervals(value, noise, whole, low, high)
        parameters[key] = {"value": value, **found, "unit": ranges[key].unit, "without": without}
    return parameters


def recording_content(prepared: Prepared, before: Fit, fit: Fit, log_score: Mapping[str, float], compared: int) -> dict:
    """Return how well the physics of the other recordings describes the held-out data of one recording.

    Parameters
    ----------
    before, fit : Fit
        Without the chosen effects, and with them.
    log_score : mapping of str to float
        Log score of the held-out data, "before" and "after".
    """
    rms = rms_of(prepared, {"before": before, "after": fit}, held_out=True)
    fitted, held_out = prepared.halves(fit)
    locations = prepared.domains(held_out, fit, fitted, alignment_tests(fit, prepared.fitter.model.distortions))
    # Corrected for the number of recordings.
    left = [location for location in locations if bonferroni(location.p, compared) < ALPHA]
    return {
        f"rms_{prepared.display.unit}": rms,
        "excess_rms_removed": excess_rms_removed(**rms),
        "log_score": dict(log_score),
        "unexplained": [{"domain": location.domain, "where": location.where, "z": location.z} for location in left],
        "alignment": fit.nuisance,
        "own": _own(fit),
    }


def alone_content(found: Alone | None) -> dict:
    """Return the parameters fitted to one recording alone, and their agreement with the others.

    Parameters
    ----------
    found : Alone or None
        None: the recordings share no parameter.
    """
    if found is None:
        return {"alone": {}, "agreement": None}
    fitted: dict[str, dict[str, dict]] = {}
    for name, values in found.fit.physics.items():
        for parameter in load(name).parameters:
            error = found.errors[name].get(parameter.name)
            if error is not None and parameter.belongs_to != OF_SCAN:
                value = values[parameter.name]
                ends = interval(value, error, parameter.low, parameter.high)
                fitted.setdefault(name, {})[parameter.name] = {"value": value, "ci95": ends}
    difference = found.difference
    agreement = asdict(difference) | {"against": list(difference.against), "disagrees": difference.disagrees}
    return {"alone": fitted, "agreement": agreement}


def removed(recordings: Mapping[str, Mapping], test: bool) -> dict | None:
    """Return median and worst share of the excess RMS that is removed, over recordings; None without a recording.

    Parameters
    ----------
    test : bool
        Whether to use the recordings that were not fitted; else the fitted ones.
    """
    chosen = [recording for recording in recordings.values() if recording["test"] == test]
    shares = [share for recording in chosen if (share := recording["excess_rms_removed"]) is not None]
    return {"median": float(np.median(shares)), "worst": float(np.min(shares))} if shares else None


def _own(fit: Fit) -> dict:
    """Return the parameters that no other recording shares, as {effect: {parameter: value}}."""
    own = {
        name: {
            parameter.name: fit.physics[name][parameter.name]
            for parameter in load(name).parameters
            if parameter.belongs_to != OF_SCANNER and parameter.name not in fit.elsewhere.get(name, ())
        }
        for name in fit.effects
    }
    return {name: values for name, values in own.items() if values}
