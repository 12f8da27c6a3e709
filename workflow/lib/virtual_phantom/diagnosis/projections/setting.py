"""A configured recording of projections, made ready: what was scanned, by which geometry, with what stated."""

from __future__ import annotations

from ...physics.chain import EVEN, Chain
from ...physics.state import AIR
from ...recordings.recording import Recording
from ...recordings.scan import view_time_note
from ..fitting.declared import BASELINE, declared
from ..request import DiagnosisRequest, NominalSettings
from ..scanned_object import coarse_scene, scene_of, whole_voxels
from ..workload import fitted
from .discretization import model_and_floor
from .observed import scans
from .prepared import PreparedScans, prepare
from .unmeasured import check_scans


def ready_scans(recording: Recording, asked: DiagnosisRequest, labels: NominalSettings) -> PreparedScans:
    """The projections of a recording, prepared for fits.

    Raises
    ------
    InputError
        For too few views or rays with a signal.
    """
    settings = asked.settings
    taken = scans(recording.repeats)
    more = {
        "sensor": labels.sensor,
        "illumination": recording.scan.get("illumination", EVEN),
        "readout": AIR if taken.white is None else float(taken.white.mean()),
    }
    scene, shape = scene_of(asked), recording.geometry.shape
    samples, step = fitted(settings.samples, settings.view_step, settings.of_shapes, shape)
    model, floor = model_and_floor(scene, recording.geometry, samples, **more)
    coarse = None
    if settings.of_phantom:
        voxels = coarse_scene(asked.phantom, asked.mu_water_per_mm, asked.materials, asked.threads)
        coarse = Chain(voxels, recording.geometry, samples=samples, **more)
    further = scans(recording.held_out) if len(recording.held_out) else None
    check_scans(taken.every(step), str(recording.document.path))
    return prepare(
        taken,
        further,
        model,
        anode=labels.anode,
        tube_kvp=labels.tube_kvp,
        nominal_photons=settings.nominal_photons or recording.nominal.get("photons"),
        known=settings.alignment,
        location=settings.location,
        declared=declared(settings.baseline, BASELINE),
        floor_chain=floor,
        coarse_chain=coarse,
        step=step,
        lacking=view_time_note(recording.scan),
        voxels=whole_voxels(asked, scene),
    )
