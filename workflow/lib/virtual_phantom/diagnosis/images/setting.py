"""A configured recording of images, made ready: by which protocol it is simulated, and which voxels count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.streams import Branch, branch
from ...physics.state import AIR
from ...reconstruction.images import in_hu
from ...recordings.images import ImagesRecording
from ..comparison.agreement import Features
from ..comparison.regions import Scanned, complete, phantom_regions
from ..comparison.relevance import agreement_and_practice
from ..fitting.declared import BASELINE, declared
from ..fitting.fit import Fit
from ..fitting.nuisance import pose_of
from ..projections.discretization import model_and_floor
from ..request import DiagnosisRequest, NominalSettings
from ..scanned_object import scene_of
from ..selection.forward_selection import Choice
from ..workload import samples_for
from .model import REALISATIONS
from .prepared import PreparedImages, prepare

MOST_SLICES = 24  # more would add little but time
LEAST_SLICES = 4  # fewer do not show noise along z, and cannot be halved where there is one repeat


def ready_images(recording: ImagesRecording, asked: DiagnosisRequest, labels: NominalSettings) -> PreparedImages:
    """The central slices of a recording, prepared for fits. The images' centre is taken for the isocentre.

    Raises
    ------
    InputError
        If too few slices are seen from every direction.
    """
    protocol, settings = asked.protocol, asked.settings
    scene = scene_of(asked)
    samples = samples_for(settings.samples, settings.of_shapes, protocol.geometry.shape)
    chains = model_and_floor(scene, protocol.geometry, samples, sensor=labels.sensor, readout=AIR)
    whole = replace(recording.grid, centre_mm=(0.0, 0.0, 0.0))
    valid = complete(protocol.geometry, whole)
    slices = central_slices(valid)
    grid = Grid((slices.stop - slices.start, *whole.shape[1:]), whole.spacing)
    # Iterative reconstruction needs the object whole; filtered back-projection makes slices one by one.
    made, shown = (grid, slice(None)) if protocol.algorithm == "fbp" else (whole, slices)

    def reconstruct(lines: np.ndarray) -> np.ndarray:
        return in_hu(
            lines.astype(np.float32),
            protocol.geometry,
            made,
            protocol.algorithm,
            protocol.settings,
            protocol.engine,
            asked.mu_water_per_mm,
            asked.threads,
        )[:, shown]

    def arrays(repeats):
        return np.stack([one.array[slices] for one in repeats]).astype(np.float32) if len(repeats) else None

    return prepare(
        arrays(recording.repeats),
        arrays(recording.held_out),
        *chains,
        reconstruct,
        grid.spacing,
        valid[slices],
        branch(asked.seed, Branch.SIMULATED_IMAGES),
        anode=labels.anode,
        tube_kvp=labels.tube_kvp,
        nominal_photons=settings.nominal_photons,
        known=settings.alignment,
        declared=declared(settings.baseline, BASELINE),
    )


def central_slices(valid: np.ndarray) -> slice:
    """The slices, alike above and below the middle, whose voxels were all seen as far out as any are.

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
            f"scan: {count - 2 * away} slices around the isocentre are seen from every direction; a diagnosis of "
            f"images needs {LEAST_SLICES}: give the protocol the scanner's rows and pitch"
        )
    return slice(away, count - away)


def agreement_of_images(
    recording: ImagesRecording,
    prepared: PreparedImages,
    choice: Choice,
    asked: DiagnosisRequest,
    purpose: Branch,
    scanned: Scanned,
    practice: bool = False,
) -> dict:
    """Agreement of the repeats held out with as many simulated ones of each model (images.agreement.agreement).

    The simulated ones, at most REALISATIONS, are those that predictions were made of, whatever the purpose.

    Parameters
    ----------
    purpose : Branch
        Not used: see above.
    practice : bool, optional
        As of projections (projections.reconstructed.agreement_of).

    Returns
    -------
    dict
        That of images.agreement.agreement, with rois (names), repeats (number), algorithm and grid, and, if asked for,
        practice.
    """
    repeats = prepared.held_out.repeats
    model, count = prepared.fitter.model, min(len(repeats), REALISATIONS)
    pose = pose_of(choice.chosen.fit.nuisance)
    grid = Grid(repeats.shape[1:], model.spacing_mm)
    regions = phantom_regions(grid, prepared.data.usable | prepared.held_out.usable, scanned, pose)

    def images(fit: Fit) -> np.ndarray:
        return model.repeats(fit.physics, fit.nuisance, fit.linearisation, count)

    features = Features(regions)
    return agreement_and_practice(repeats, images, choice, regions, features, practice) | {
        "algorithm": asked.protocol.algorithm,
        "grid": {"shape": list(grid.shape), "spacing_mm": list(grid.spacing)},
    }
