"""A scanner's diagnosis: several recordings, one physics, judged by the recordings that were not fitted."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..fitting.fit import Fit
from ..fitting.joint_fit import JointFit, JointFitter
from ..residuals.dataset import Prepared
from ..selection.joint_selection import JointChoice, choose_jointly
from ..uncertainty.model_error import errors_of_pulled, pulled_of_recordings
from ..verdict.verdict import VERDICTS
from .consistency import Alone, alone
from .content import alone_content, declared_content, effect_content, recording_content, removed, sentence


@dataclass(frozen=True)
class ScannerDiagnosis:
    """Everything that is reported.

    Attributes
    ----------
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
    found = {
        recording: protocol
        for protocol, recordings in (stated or {}).items()
        for recording in recordings
        if recording in prepared
    }
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
    judged_on: Sequence[str] = (),
) -> ScannerDiagnosis:
    """Choose the effects that explain recordings together, and judge them on each by the physics of the others.

    Parameters
    ----------
    name : str
        Of the scanner.
    prepared : mapping of str to Prepared
        By recording.
    accuracy : mapping of str to float
        As core.attribute.choose takes it.
    protocols : mapping of str to sequence of str, optional
        As protocols_of takes them.
    objects : mapping of str to str, optional
        What each recording is of: those of one object are left out together.
    judged_on : sequence of str, optional
        Recordings by which no effect is chosen, and to which no physics is fitted.

    Raises
    ------
    InputError
        As choose_jointly.
    """
    every = JointFitter({key: one.fitter for key, one in prepared.items()}, protocols_of(prepared, protocols))
    together = every.without(judged_on)
    choice = choose_jointly(together, candidates, accuracy, objects)
    judged, chosen = _Judged.of(every, choice, judged_on), choice.chosen
    errors: Mapping[str, Mapping] = {}
    apart: Mapping[str, Alone] = {}
    if together.whole(chosen.effects):
        scans = pulled_of_recordings(every, judged.chosen, judged.without, accuracy)
        errors = errors_of_pulled({key: scans[key] for key in together.fitters})
        apart = alone(every, chosen, scans, judged_on)
    known, of_protocols = declared_content(together, chosen, errors)
    off = any(one["off"] for each in (known, *of_protocols.values()) for keys in each.values() for one in keys.values())
    before, after, scores = choice.before | judged.before, choice.left_out | judged.after, choice.scores | judged.scores
    recordings = {
        key: {"judged": key in judged_on, "protocol": every.protocols[key]}
        | recording_content(one, before[key], after[key], scores[key], len(prepared))
        | alone_content(apart.get(key))
        for key, one in prepared.items()
    }
    left = any(one["unexplained"] or (one["agreement"] or {}).get("disagrees") for one in recordings.values())
    content = {
        "scanner": name,
        "verdict": VERDICTS[(2 if left else 1) if chosen.effects or off else (3 if left else 0)],
        "effects": [effect_content(effect, choice, together.protocols, errors) for effect in chosen.effects],
        "declared": known,
        "declared_of_protocols": of_protocols,
        "recordings": recordings,
        "excess_rms_removed": removed(recordings, judged=False) if chosen.effects else None,
        "excess_rms_removed_judged": removed(recordings, judged=True) if chosen.effects else None,
        "effects_tried": list(candidates),
    }
    return ScannerDiagnosis(choice, content | {"sentence": sentence(content)})


@dataclass(frozen=True)
class _Judged:
    """Recordings that were not fitted, by the physics of those that were.

    Attributes
    ----------
    before, after : dict of str to Fit
        By recording, without the chosen effects and with them.
    scores : dict of str to dict of str to float
        As JointChoice.scores.
    chosen : JointFit
        Of those that were fitted, with these beside them.
    without : dict of str to JointFit
        {effect: the same without it}.
    """

    before: dict[str, Fit]
    after: dict[str, Fit]
    scores: dict[str, dict[str, float]]
    chosen: JointFit
    without: dict[str, JointFit]

    @classmethod
    def of(cls, every: JointFitter, choice: JointChoice, names: Sequence[str]) -> _Judged:
        """Hold recordings against what was chosen by the others."""
        before = every.held(choice.baseline, {name: every.fitters[name].fit(()) for name in names})

        def beside(fit: JointFit) -> JointFit:
            return replace(fit, fits=fit.fits | every.held(fit, before))

        chosen = beside(choice.chosen)
        without = {effect: beside(fit) for effect, fit in choice.without.items()}
        after = {name: chosen.fits[name] for name in names}
        scores = {
            name: {"before": every.fitters[name].score(before[name]), "after": every.fitters[name].score(after[name])}
            for name in names
        }
        return cls(before, after, scores, chosen, without)
