"""Diagnosis of one recording: for the workflow, Python, the blind validation and benchmarks.

`run_diagnosis` does all steps from the files of a recording to the verdict. `find_missing_physics` and
`apply_known_physics` are alternatives for its central step, and take a prepared recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ..base.streams import Branch
from ..physics.effect import applicable_effects
from ..recordings.reading import load_recording
from ..recordings.recording import Recording
from ..recordings.scan import ELEMENT
from ..statistics.proof_record import RecordedRun, with_coverage
from .assumptions import model_assumptions
from .candidate_effects import require_angles
from .comparison.regions import ScannedVolume
from .comparison.relevance import judge_relevance
from .fitting.fit import Fit
from .fitting.trial import trial
from .images.other_scan import with_other_scan
from .images.scan import with_scan
from .preparation import compare_images, prepare_recording
from .request import DiagnosisRequest
from .residuals.dataset import Change, Prepared
from .selection.fit_cache import FitCache
from .selection.forward_selection import LEAST_GAIN, Choice, ForwardSelection
from .selection.progress import ALIGNED, COMPARED, JUDGED, DiagnosisProgress
from .selection.screening import screened
from .selection.transfer import Physics, fit_with_fixed_physics, with_physics_source
from .selection.trials import trials
from .setup.check import check_setup, setup_diagnosis
from .setup.unknown_object import unknown_object_diagnosis
from .uncertainty.model_error import errors_with_models
from .verdict.object_mismatch import (
    MOST_MISMATCHES,
    better_than,
    beyond_effects,
    differing,
    explains_all,
    mismatch_beside_effects,
    no_physics,
)
from .verdict.unmodeled import ChangesOfFits
from .verdict.verdict import Diagnosis, diagnose
from .verdict_text import SETUP_VERDICTS, recording_lines, with_verdict_text

WITHOUT_SCALE = "spectrum, scatter and other effects of lengths in mm, as lengths are in detector elements"
# Errors of the object are linearized where a fit without effects puts its surfaces. Missing physics displaces these, so
# effects are selected again about a fit with effects, this many times at most. The change of chi-square from which this
# is done is that of the least gain of an effect.
MOST_SELECTIONS, MOST_SELECTION_ERROR = 2, 2 * LEAST_GAIN
# The fit of the selected effects is repeated until linearization changes it by less than its standard error. A wrong
# source distance of 1.5 % took four repetitions (case_023 of seed 4274920483 of the blind validation).
MOST_REFITS, MOST_FIT_ERROR = 6, 1.0
# A fit with the effects selected so far, None if the selection has ended, and a function that returns its result.
Begun = tuple[Fit | None, Callable[[], Choice]]
# Called after the set-up check; returns the cached fits of an earlier run and the progress of this one.
StartOfFits = Callable[[DiagnosisRequest, Recording], tuple[FitCache | None, DiagnosisProgress]]


def run_diagnosis(
    request: DiagnosisRequest,
    effects: Sequence[str],
    accuracy: Mapping[str, float],
    *,
    physics: Physics | None = None,
    same_material: bool = True,
    images: bool = True,
    study_rois: tuple[str, str] | None = None,
    shape_rois: bool = True,
    thresholds: Mapping[str, float] | None = None,
    coverage: Sequence[RecordedRun] | None = None,
    start_of_fits: StartOfFits | None = None,
) -> Diagnosis:
    """Diagnose a recording.

    1. Read the recording and check its set-up. A wrong set-up or object ends the diagnosis.
    2. Prepare the data for fits: data to fit and data held out, noise, and the model of the scan.
    3. Select the effects that explain the data, or apply physics that was found on another recording.
    4. Compare recording and models in reconstructed images, and judge the relevance of each effect there.
    5. Write the verdict.

    Parameters
    ----------
    effects : sequence of str
        Candidates. Effects that the request declares are ignored.
    accuracy : mapping of str to float
        Relative model error by effect (`diagnosis.model_accuracy`).
    physics : Physics, optional
        Physics of another recording: only the alignment is fitted, no effect is selected.
    same_material : bool, optional
        Whether the object of `physics` is of the same material.
    study_rois : tuple of str, optional
        Paths of the study's phantom image and of its table of ROIs, for a scan of this phantom.
    shape_rois : bool, optional
        Whether an object of shapes is compared in its ROIs.
    thresholds : mapping of str to float, optional
        Relevance thresholds (`diagnosis.matters`); None: every significant effect is relevant.
    coverage : sequence of RecordedRun, optional
        Record of the blind validation, for the coverage of confidence intervals.
    start_of_fits : callable, optional
        See StartOfFits; without it no fit is reused and no progress reported.

    Raises
    ------
    InputError
        For a recording that cannot be read or diagnosed.
    """
    recording = load_recording(request.folder)
    request = request.with_energy(recording.nominal)
    if request.settings.of_unknown:
        return unknown_object_diagnosis(recording)
    require_angles(recording.document.content, str(recording.document.path))
    request = with_other_scan(request, recording)
    setup = check_setup(recording, request)
    if setup is not None and setup.kind in SETUP_VERDICTS:
        return setup_diagnosis(setup, recording, request)
    stated_location = request.settings.location
    if setup is not None:
        request = request.located(setup.content["location"])
    if recording.kind == "images":
        request = with_scan(replace(request, mirrored=bool(setup and setup.mirrored)), recording)
    cache, progress = start_of_fits(request, recording) if start_of_fits else (None, DiagnosisProgress())
    _, prepared = prepare_recording(request, recording)
    if physics is not None:
        effects = []
        found = apply_known_physics(recording.name, prepared, physics, same_material, accuracy.get("numerical", 0.0))
    else:
        effects = [name for name in effects if name not in request.settings.baseline]
        differ = request.settings.object_may_differ
        found = find_missing_physics(
            recording.name, prepared, effects, accuracy, request.threads, cache, progress, differ
        )
    content = with_coverage(found.content, coverage) if coverage is not None else dict(found.content)
    content["modelled"] = model_assumptions(request, recording, found.prepared, effects)
    scene = found.prepared.fitter.model.chain.scene
    scanned = ScannedVolume.of(request, recording, study_rois, shape_rois, scene) if images else None
    if images:
        content["agreement"] = compare_images(
            recording, found.prepared, found.halves, request, Branch.AGREEMENT, scanned, thresholds is not None
        )
        progress.reached(COMPARED)
    if thresholds is not None:
        content = judge_relevance(content, thresholds)
    if setup is not None:
        content["setup"] = dict(setup.content)
    if recording.scan.get("length_unit") == ELEMENT:
        content["not_determined"] = WITHOUT_SCALE
    content = with_verdict_text(content, recording_lines(content, stated_location))
    return replace(found, content=content, scanned=scanned)


def find_missing_physics(
    name: str,
    prepared: Prepared,
    effects: Sequence[str],
    accuracy: Mapping[str, float],
    processes: int = 1,
    cache: FitCache | None = None,
    progress: DiagnosisProgress | None = None,
    object_may_differ: bool | float = False,
) -> Diagnosis:
    """Select the effects that explain a prepared recording, and judge them.

    Parameters
    ----------
    object_may_differ : bool or float, optional
        Whether local object mismatches that explain more than any effect are corrected before effects are selected. A
        number limits this to mismatches of at most that width, mm.
    """
    progress, numerical, changes = progress or DiagnosisProgress(), accuracy.get("numerical", 0.0), ChangesOfFits()
    widest_mm = math.inf if object_may_differ is True else float(object_may_differ)
    corrected: list[Change] = []

    def may_be_corrected(local: Change) -> bool:
        return local.mismatch.content["width_mm"] <= widest_mm

    def begin(given: Prepared, cache: FitCache | None) -> Begun:
        (baseline,) = trials(given.whole, [((),)], cache=cache)
        progress.reached(ALIGNED)
        local = None
        if len(corrected) < MOST_MISMATCHES:
            aligned = given.fitter.fit((), baseline.fit)
            local = differing(changes(given, aligned, numerical))
        if local is not None and corrected and not may_be_corrected(local):
            local = None  # too wide to be corrected: select effects with the object as corrected so far
        if local is not None:
            applicable = applicable_effects(effects, given.fitter.model.with_declared_effects(()))
            alone = screened(given.fitter, aligned, applicable, processes, progress, accuracy) if applicable else {}
            if beyond_effects(local, alone) or explains_all(local, given, aligned):
                return None, lambda: no_physics(baseline, local, numerical)
        selection = ForwardSelection.of(given.whole, baseline, effects, processes, accuracy, cache, progress)
        selection.add_effects()

        def judged() -> Choice:
            choice = selection.judged()
            better = local is not None and not corrected and better_than(local, choice.on_halves(given))
            return no_physics(baseline, local, numerical) if better else choice

        return selection.current.fit, judged

    while True:
        # Cached fits were made without corrections, so they are of no use after the first correction.
        prepared, choice = _linearized(*_settled(prepared, begin, None if corrected else cache))
        halves, local = choice.on_halves(prepared), None
        if widest_mm and len(corrected) < MOST_MISMATCHES:
            local = choice.mismatch or mismatch_beside_effects(prepared, halves, changes)
        if local is None or not may_be_corrected(local):
            break
        prepared, corrected = prepared.with_mismatch(local.mismatch, halves.chosen.fit), [*corrected, local]
    fitted = prepared.mismatches(halves.chosen.fit) if corrected else ()
    corrected = [
        replace(change, words=mismatch.words, mismatch=mismatch)
        for change, mismatch in zip(corrected, fitted, strict=True)
    ]
    errors = errors_with_models(prepared.whole, choice.chosen.fit, choice.without, accuracy)
    found = diagnose(name, prepared, replace(choice, errors=errors), halves, corrected, changes, effects)
    progress.reached(JUDGED)
    return found


def apply_known_physics(
    name: str, prepared: Prepared, physics: Physics, same_material: bool, numerical: float = 0.0
) -> Diagnosis:
    """Judge a prepared recording by physics that was found on another one: only the alignment is fitted.

    Parameters
    ----------
    numerical : float, optional
        Relative error of discretization corrections (`diagnosis.model_accuracy.numerical`).
    """

    def begin(given: Prepared, _cache: FitCache | None) -> Begun:
        choice = fit_with_fixed_physics(given.fitter, trial(given.fitter, ()), physics, same_material, numerical)
        return choice.chosen.fit, lambda: choice

    prepared, choice = _settled(prepared, begin, None)
    found = diagnose(name, prepared, choice)
    return replace(found, content=with_physics_source(found.content, physics))


def _settled(
    prepared: Prepared, begin: Callable[[Prepared, FitCache | None], Begun], cache: FitCache | None
) -> tuple[Prepared, Choice]:
    """Select effects, and select again if they change what the preparation of the recording assumed.

    These are the surfaces about which errors of the object are linearized, and the noise correlations of recordings
    that do not determine them. All models are then refitted, so that they are compared by the same likelihood.

    Parameters
    ----------
    begin : callable
        Begins the selection for a prepared recording.
    cache : FitCache or None
        For the first selection only.
    """

    def select(prepared: Prepared, cache: FitCache | None) -> tuple[Prepared, Choice]:
        fit, judged = begin(prepared, cache)
        for _ in range(MOST_SELECTIONS):
            again = prepared if fit is None else prepared.linearized_at(fit, MOST_SELECTION_ERROR)
            if again is prepared:
                break
            prepared, (fit, judged) = again, begin(again, None)
        return prepared, judged()

    prepared, choice = select(prepared, cache)
    again = prepared.with_noise_of(choice.chosen.fit)
    return (prepared, choice) if again is prepared else select(again, None)


def _linearized(prepared: Prepared, choice: Choice) -> tuple[Prepared, Choice]:
    """Linearize errors of the object where the selected effects put its surfaces, and repeat the fits of the choice."""
    there, fit = prepared, choice.chosen.fit
    for _ in range(MOST_REFITS if fit.effects else 0):
        again = there.linearized_at(fit, MOST_FIT_ERROR)
        if again is there:
            break
        there, fit = again, again.whole.fit(fit.effects, fit)
    return there, choice if there is prepared else choice.refitted(there.whole)
