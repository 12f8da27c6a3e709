"""Preparation of a recording for fits, and its comparison in images, by the kind of recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ..base.errors import InputError, naming
from ..base.streams import Branch
from ..physics.chain import EVEN, Chain
from ..physics.scenes.sampling import FEW_POINTS
from ..physics.state import AIR
from ..recordings.reading import load_recording
from ..recordings.recording import Recording
from ..recordings.scan import scale_note, view_time_note
from .comparison.regions import ScannedVolume
from .comparison.scans import agreement_of_scans
from .fitting.fit import Fit
from .fitting.nuisance import POSES
from .fitting.priors import BASELINE_CONFIG_KEY, declared
from .images.setting import agreement_of_images, prepare_images
from .projections.discretization import model_and_floor
from .projections.lost_rays import check_scans
from .projections.object_errors import StatedObject
from .projections.observed import scans
from .projections.own_simulation import rays_of_simulation, scene_of_scan
from .projections.prepared import MOST_PULL, PreparedScans, largest_surface_pull, prepare
from .request import DiagnosisRequest, NominalSettings, nominal_settings
from .residuals.dataset import Prepared
from .scanned_object import binary_voxels_remark, coarse_scene
from .selection.forward_selection import Choice
from .workload import samples_and_step

# Rays at edges are not linear in the position and the surfaces of the object. Their changes are therefore computed
# again where a fit without effects puts it, until chi-square changes by less than CONVERGED. The error of chi-square
# grows with the cube of the displacement: 244 at 0.06 mm, with 4 x 10^5 photons in columns of 1.7 mm. Voxels of shares
# or HU do not show surfaces as precisely as shapes and labels.
CONVERGED = 1.0
PRECISE, OTHERS = 8, 2  # most fits
FIXED = 1e-7  # standard deviation of a size that is not fitted


def prepare_recording(request: DiagnosisRequest, recording: Recording | None = None) -> tuple[Recording, Prepared]:
    """Read a recording, unless it is given, and prepare it for fits.

    Raises
    ------
    InputError
        For a recording of another kind, and for a nominal anode or tube voltage without a known spectrum.
    """
    recording = recording or load_recording(request.folder)
    if recording.kind not in PREPARATIONS:
        raise InputError(f"{recording.document.path}: holds {recording.kind}, which are diagnosed by comparison")
    request = request.with_energy(recording.nominal)
    with naming(recording.document.path):
        return recording, PREPARATIONS[recording.kind](recording, request, nominal_settings(recording))


def prepare_projections(recording: Recording, request: DiagnosisRequest, nominal: NominalSettings) -> PreparedScans:
    """Prepare the projections of a recording for fits.

    Raises
    ------
    InputError
        For too few views, or too few rays with a signal.
    """
    settings, taken = request.settings, scans(recording.repeats)
    detector = {
        "sensor": nominal.sensor,
        "illumination": recording.scan.get("illumination", EVEN),
        "readout": AIR if taken.white is None else float(taken.white.mean()),
        "fewest_points": FEW_POINTS,
    }
    scene, shape = scene_of_scan(request, recording), recording.geometry.shape
    stated = settings.samples or rays_of_simulation(scene, shape)
    samples, step = samples_and_step(stated, settings.view_step, shape)
    coarse = None
    if settings.of_phantom:
        voxels = coarse_scene(request.phantom, request.mu_water_per_mm, request.materials, request.threads)
        coarse = Chain(voxels, recording.geometry, samples=samples, **detector)
    further = scans(recording.held_out) if len(recording.held_out) else None
    check_scans(taken.every(step), str(recording.document.path))
    uncertain = StatedObject.of(request, scene)
    settled = partial(
        prepare,
        taken,
        further,
        anode=nominal.anode,
        tube_kvp=nominal.tube_kvp,
        nominal_photons=settings.nominal_photons or recording.nominal.get("photons"),
        location=settings.location,
        declared=declared(settings.baseline, BASELINE_CONFIG_KEY),
        coarse_chain=coarse,
        step=step,
        uncertain=uncertain,
    )
    known = request.alignment(recording.nominal)

    def ready(known: Mapping[str, float], first: Fit | None) -> PreparedScans:
        fitted = scene if uncertain is None or first is None else uncertain.with_surfaces(first.nuisance)
        model, floor = model_and_floor(fitted, recording.geometry, samples, **detector)
        return settled(model, floor_chain=floor, known=known, first=first)

    first, most = None, 0
    if uncertain is not None and uncertain.has_surfaces:
        most = PRECISE if uncertain.has_precise_surfaces else OTHERS
    for _ in range(most):
        # A free size would take the place of surfaces while these are linear.
        fit = ready(known | {"size": FIXED}, first).fitter.fit(())
        before = np.inf if first is None else first.chi_square
        if largest_surface_pull(fit) > MOST_PULL:
            first = replace(fit, nuisance={name: value for name, value in fit.nuisance.items() if name in POSES})
            break
        first = fit
        if abs(fit.chi_square - before) < CONVERGED:
            break
    times = "; ".join(filter(None, (scale_note(recording.scan), view_time_note(recording.scan))))
    remark = binary_voxels_remark(request, scene)
    # A single ray per pixel is not divided at edges, so that surfaces change line integrals in steps.
    movable = uncertain is not None and samples > 1

    def about(first: Fit | None) -> PreparedScans:
        found = ready(known, first)
        return replace(found, time_remark=times, voxels=remark, about=about if movable else None)

    return about(first)


def compare_images(
    recording: Recording,
    prepared: Prepared,
    choice: Choice,
    request: DiagnosisRequest,
    purpose: Branch,
    scanned: ScannedVolume | None,
    with_changes: bool = False,
) -> dict:
    """Return the agreement of models with the held-out repeats in images; arguments as in `agreement_of_scans`."""
    return AGREEMENTS[recording.kind](recording, prepared, choice, request, purpose, scanned, with_changes)


# By kind of recording.
PREPARATIONS = {"projections": prepare_projections, "images": prepare_images}
AGREEMENTS = {"projections": agreement_of_scans, "images": agreement_of_images}
