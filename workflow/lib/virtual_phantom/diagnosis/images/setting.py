"""Prepare a recording of images for fits: the protocol that simulates it, and the voxels that are compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.streams import Branch, branch
from ...physics.state import AIR
from ...reconstruction.images import reconstruct_hu
from ...recordings.images import ImagesRecording
from ..comparison.agreement import Features
from ..comparison.regions import ScannedVolume, complete, phantom_regions
from ..comparison.relevance import agreement_and_changes
from ..fitting.fit import Fit
from ..fitting.nuisance import pose_of
from ..fitting.priors import BASELINE_CONFIG_KEY, declared
from ..projections.discretization import model_and_floor
from ..request import DiagnosisRequest, NominalSettings
from ..scanned_object import scene_of
from ..selection.forward_selection import Choice
from ..workload import samples_for
from .model import REALIZATIONS
from .prepared import PreparedImages, prepare

MOST_SLICES = 24  # more slices add run time and little information
LEAST_SLICES = 4  # fewer do not show noise correlation along z, and cannot be split for a single repeat


def prepare_images(recording: ImagesRecording, request: DiagnosisRequest, nominal: NominalSettings) -> PreparedImages:
    """Prepare the central slices of a recording for fits. The center of the images is assumed to be the isocenter.

    Raises
    ------
    InputError
        If too few slices are seen from all directions.
    """
    protocol, settings = request.protocol, request.settings
    scene = scene_of(request)
    samples = samples_for(settings.samples, settings.of_shapes, protocol.geometry.shape)
    chains = model_and_floor(scene, protocol.geometry, samples, sensor=nominal.sensor, readout=AIR)
    whole = replace(recording.grid, centre_mm=(0.0, 0.0, 0.0))
    valid = complete(protocol.geometry, whole)
    slices = central_slices(valid)
    grid = Grid((slices.stop - slices.start, *whole.shape[1:]), whole.spacing)
    # Iterative reconstruction needs the whole object; filtered back-projection reconstructs slice by slice.
    made, shown = (grid, slice(None)) if protocol.algorithm == "fbp" else (whole, slices)

    def reconstruct(lines: np.ndarray) -> np.ndarray:
        return reconstruct_hu(
            lines.astype(np.float32),
            protocol.geometry,
            made,
            protocol.algorithm,
            protocol.settings,
            protocol.engine,
            request.mu_water_per_mm,
            request.threads,
        )[:, shown]

    def arrays(repeats):
        return np.stack([repeat.array[slices] for repeat in repeats]).astype(np.float32) if len(repeats) else None

    return prepare(
        arrays(recording.repeats),
        arrays(recording.held_out),
        *chains,
        reconstruct,
        grid.spacing,
        valid[slices],
        branch(request.seed, Branch.SIMULATED_IMAGES),
        anode=nominal.anode,
        tube_kvp=nominal.tube_kvp,
        nominal_photons=settings.nominal_photons,
        known=settings.alignment,
        declared=declared(settings.baseline, BASELINE_CONFIG_KEY),
    )


def central_slices(valid: np.ndarray) -> slice:
    """Return the slices, symmetric about the middle, with the largest complete field of view.

    Parameters
    ----------
    valid : ndarray of bool, shape (z, y, x)

    Raises
    ------
    InputError
        If there are fewer than LEAST_SLICES.
    """
    full = valid.sum(axis=(1, 2)) == valid.sum(axis=(1, 2)).max()
    count = len(full)
    away = 0
    while away < count // 2 and full[away : count - away].all() is np.False_:
        away += 1
    away = max(away, (count - MOST_SLICES) // 2)
    if count - 2 * away < LEAST_SLICES:
        raise InputError(
            f"scan: {count - 2 * away} slices around the isocenter are seen from every direction; a diagnosis of "
            f"images needs {LEAST_SLICES}: give the protocol the scanner's rows and pitch"
        )
    return slice(away, count - away)


def agreement_of_images(
    recording: ImagesRecording,
    prepared: PreparedImages,
    choice: Choice,
    request: DiagnosisRequest,
    purpose: Branch,
    scanned: ScannedVolume,
    with_changes: bool = False,
) -> dict:
    """Return the agreement of the held-out repeats with simulated images of each model, as `agreement_of_repeats`.

    The simulated images of the fit are used, at most REALIZATIONS, so `purpose` has no effect.
    """
    repeats = prepared.held_out.repeats
    model, count = prepared.fitter.model, min(len(repeats), REALIZATIONS)
    pose = pose_of(choice.chosen.fit.nuisance)
    grid = Grid(repeats.shape[1:], model.spacing_mm)
    regions = phantom_regions(grid, prepared.data.usable | prepared.held_out.usable, scanned, pose)

    def images(fit: Fit) -> np.ndarray:
        return model.repeats(fit.physics, fit.nuisance, fit.linearization, count)

    features = Features(regions)
    return agreement_and_changes(repeats, images, choice, regions, features, with_changes) | {
        "algorithm": request.protocol.algorithm,
        "grid": {"shape": list(grid.shape), "spacing_mm": list(grid.spacing)},
    }
