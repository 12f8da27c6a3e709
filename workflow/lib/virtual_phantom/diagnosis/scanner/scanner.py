"""Joint diagnosis of several recordings of one scanner, judged on recordings that were not fitted."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ...base.errors import naming
from ...base.settings import to_mapping
from ..fitting.fit import Fit
from ..fitting.joint_fit import JointFit, JointFitter
from ..residuals.dataset import Prepared
from ..selection.joint_selection import JointChoice, choose_jointly
from ..settings import RecordingSettings
from ..uncertainty.model_error import influences_of_recordings, joint_errors_with_models
from ..verdict_text import scanner_lines, verdict_of, with_verdict_text
from .consistency import Alone, alone
from .content import alone_content, declared_content, effect_content, recording_content, removed


@dataclass(frozen=True)
class ScannerDiagnosis:
    """Result of a joint diagnosis; `content` is the content of scanner.json."""

    choice: JointChoice
    content: dict


def protocols_of(prepared: Mapping[str, Prepared], stated: Mapping[str, Sequence[str]] | None = None) -> dict[str, str]:
    """Return the protocol of each recording; all "" if there is only one protocol.

    Parameters
    ----------
    stated : mapping of str to sequence of str, optional
        {protocol: its recordings}. The other recordings are grouped by their stated tube voltage.
    """
    found = {
        recording: protocol
        for protocol, recordings in (stated or {}).items()
        for recording in recordings
        if recording in prepared
    }
    for name, recording in prepared.items():
        kvp = recording.fitter.model.tube_kvp
        found.setdefault(name, "voltage not stated" if kvp is None else f"{kvp:g} kV")
    return found if len(set(found.values())) > 1 else dict.fromkeys(found, "")


def scanned_in(settings: RecordingSettings) -> str:
    """Return the scanned object of a recording as a string that is equal for equal objects."""
    return json.dumps(to_mapping((settings.disc, settings.object, settings.simulation)), sort_keys=True)


def run_scanner_diagnosis(
    name: str,
    prepared: Mapping[str, Prepared],
    candidates: Sequence[str],
    accuracy: Mapping[str, float],
    protocols: Mapping[str, Sequence[str]] | None = None,
    objects: Mapping[str, str] | None = None,
    test_recordings: Sequence[str] = (),
) -> ScannerDiagnosis:
    """Select the effects that explain recordings together, and judge them on each by the physics of the others.

    Parameters
    ----------
    accuracy : mapping of str to float
        Relative model error by effect (`diagnosis.model_accuracy`).
    protocols : mapping of str to sequence of str, optional
        See protocols_of.
    objects : mapping of str to str, optional
        Scanned object of each recording. Recordings of one object are held out together.
    test_recordings : sequence of str, optional
        Test recordings: they are used neither to select effects nor to fit physics.

    Raises
    ------
    InputError
        For fewer than two recordings.
    """
    every = JointFitter({key: data.fitter for key, data in prepared.items()}, protocols_of(prepared, protocols))
    together = every.without(test_recordings)
    with naming(f"diagnosis.scanners.{name}.recordings"):
        choice = choose_jointly(together, candidates, accuracy, objects)
    judged, chosen = _TestRecordings.of(every, choice, test_recordings), choice.chosen
    errors: Mapping[str, Mapping] = {}
    each_alone: Mapping[str, Alone] = {}
    if together.with_declared_effects(chosen.effects):
        scans = influences_of_recordings(every, judged.chosen, judged.without, accuracy)
        errors = joint_errors_with_models({key: scans[key] for key in together.fitters})
        each_alone = alone(every, chosen, scans, test_recordings)
    known, of_protocols = declared_content(together, chosen, errors)
    off = any(
        value["off"]
        for declared in (known, *of_protocols.values())
        for parameters in declared.values()
        for value in parameters.values()
    )
    before, after, scores = choice.before | judged.before, choice.left_out | judged.after, choice.scores | judged.scores
    recordings = {
        key: {"test": key in test_recordings, "protocol": every.protocols[key]}
        | recording_content(data, before[key], after[key], scores[key], len(prepared))
        | alone_content(each_alone.get(key))
        for key, data in prepared.items()
    }
    left = any(
        recording["unexplained"] or (recording["agreement"] or {}).get("disagrees") for recording in recordings.values()
    )
    content = {
        "scanner": name,
        "verdict": verdict_of(bool(chosen.effects) or off, left),
        "effects": [effect_content(effect, choice, together.protocols, errors) for effect in chosen.effects],
        "declared": known,
        "declared_of_protocols": of_protocols,
        "recordings": recordings,
        "excess_rms_removed": removed(recordings, test=False) if chosen.effects else None,
        "excess_rms_removed_in_tests": removed(recordings, test=True) if chosen.effects else None,
        "effects_tried": list(candidates),
    }
    return ScannerDiagnosis(choice, with_verdict_text(content, scanner_lines(content)))


@dataclass(frozen=True)
class _TestRecordings:
    """Test recordings, judged by the physics of the fitted ones.

    Attributes
    ----------
    before, after : dict of str to Fit
        By recording, without the chosen effects and with them.
    scores : dict of str to dict of str to float
        See JointChoice.scores.
    chosen : JointFit
        The joint fit with the test recordings added.
    without : dict of str to JointFit
        {effect: the joint fit without it}.
    """

    before: dict[str, Fit]
    after: dict[str, Fit]
    scores: dict[str, dict[str, float]]
    chosen: JointFit
    without: dict[str, JointFit]

    @classmethod
    def of(cls, every: JointFitter, choice: JointChoice, names: Sequence[str]) -> _TestRecordings:
        """Judge recordings by the effects that were chosen on the others."""
        before = every.fit_with_fixed_physics(choice.baseline, {name: every.fitters[name].fit(()) for name in names})

        def beside(fit: JointFit) -> JointFit:
            return replace(fit, fits=fit.fits | every.fit_with_fixed_physics(fit, before))

        chosen = beside(choice.chosen)
        without = {effect: beside(fit) for effect, fit in choice.without.items()}
        after = {name: chosen.fits[name] for name in names}
        scores = {
            name: {"before": every.fitters[name].score(before[name]), "after": every.fitters[name].score(after[name])}
            for name in names
        }
        return cls(before, after, scores, chosen, without)
