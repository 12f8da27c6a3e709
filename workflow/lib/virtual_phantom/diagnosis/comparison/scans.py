"""Agreement of recorded projections with models, in images with the same reconstruction."""

from __future__ import annotations

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid, OrbitGeometry
from ...base.streams import Branch, Stream, below, branch, generator
from ...base.units import attenuation_to_hu
from ...projectors import projector
from ...reconstruction.fbp import fbp
from ...recordings.recording import Recording
from ..fitting.fit import Fit
from ..fitting.nuisance import pose_of
from ..projections.observed import LEAST_TRANSMISSION, Scans, scans
from ..projections.prepared import HALVES, PreparedScans, split
from ..request import DiagnosisRequest
from ..selection.forward_selection import Choice
from .agreement import Features
from .regions import ScannedVolume, complete, disc_regions, image_grid, phantom_regions
from .relevance import agreement_and_changes

NOISE, CORRELATION = 0, 1  # branches of the seed for simulated noise, and for images that show its correlation
CORRELATED_REPEATS = 8  # fewest of these images


def agreement_of_scans(
    recording: Recording,
    prepared: PreparedScans,
    choice: Choice,
    request: DiagnosisRequest,
    purpose: Branch,
    scanned: ScannedVolume | None,
    with_changes: bool,
) -> dict:
    """Return the agreement of the held-out repeats with models, in images.

    Parameters
    ----------
    purpose : Branch
        Branch of the random stream for simulated noise.
    scanned, with_changes
        As in `agreement_of_repeats`.
    """
    further = scans(recording.held_out) if len(recording.held_out) else None
    repeats = held_out_repeats(scans(recording.repeats), further).every(prepared.step)
    seed, mu_water = branch(request.seed, purpose), request.mu_water_per_mm
    return agreement_of_repeats(
        repeats, prepared, choice, mu_water, seed, scanned, with_changes, threads=request.threads
    )


def agreement_of_repeats(
    repeats: Scans,
    prepared: PreparedScans,
    choice: Choice,
    mu_water_per_mm: float,
    seed: Stream,
    scanned: ScannedVolume | None = None,
    with_changes: bool = False,
    threads: int = 1,
) -> dict:
    """Return the agreement of repeats of projections with models, in images.

    "before" is the model with alignment alone, "after" the chosen model. Each is simulated with as many repeats as the
    recording has, and with the same random numbers, so noise does not contribute to their difference. All are
    reconstructed by filtered back-projection. Edge and ROIs are at the object location of the chosen model.

    Parameters
    ----------
    scanned : ScannedVolume, optional
        None for a disc.
    with_changes : bool, optional
        Whether to compute the change that each effect makes, which takes one reconstruction per effect.

    Returns
    -------
    dict
        Result of relevance.agreement_and_changes, with algorithm. If the scan cannot be reconstructed, no metrics but
        the reason.
    """
    chain = prepared.fitter.model.chain
    pose, shown = pose_of(choice.chosen.fit.nuisance), scanned or chain.scene
    try:
        grid = image_grid(chain.geometry, shown.radius_mm)
        regions_of = disc_regions if scanned is None else phantom_regions
        regions = regions_of(grid, complete(chain.geometry, grid), shown, pose)
        how = repeats.usable, chain.geometry, grid, mu_water_per_mm, threads
        recorded = reconstructed(repeats.repeats, *how)
    except InputError as error:
        return {"metrics": {}, "left_out": {"images": str(error)}}

    def images(fit: Fit, keys: tuple[int, ...] = (NOISE,)) -> np.ndarray:
        # A new stream for each fit, so that all have the same random numbers.
        return reconstructed(simulated_repeats(prepared, fit, len(repeats), generator(below(seed, *keys))), *how)

    noise = None
    if 1 < len(repeats) < CORRELATED_REPEATS:  # as many at once as the recording has, for the memory
        sets = range(-(-CORRELATED_REPEATS // len(repeats)))
        noise = np.concatenate([images(choice.chosen.fit, (CORRELATION, number)) for number in sets])
    features = Features(regions) if scanned is not None and scanned.rois else None
    found = agreement_and_changes(recorded, images, noise, choice, regions, features, with_changes)
    return found | {"algorithm": "fbp"}


def held_out_repeats(taken: Scans, further: Scans | None) -> Scans:
    """Return the held-out repeats (prepared.split), or all repeats if every second view was held out instead."""
    if further is None and len(taken) < HALVES:
        return taken
    return split(taken, further)[1]


def simulated_repeats(prepared: PreparedScans, fit: Fit, count: int, random: np.random.Generator) -> np.ndarray:
    """Return noisy line integrals of a fitted model with its alignment and gain pattern.

    Returns
    -------
    ndarray of float32, shape (count, views, rows, columns)
    """
    state = prepared.fitter.predicted(fit, held_out=True).state
    air = state.measured_air * state.photons
    pattern = 0.0 if fit.pattern is None else fit.pattern.over_data(fit.pattern.values)
    transmissions = (np.maximum(state.counts(random) / air, LEAST_TRANSMISSION) for _ in range(count))
    scale, offset = fit.nuisance["scale"], fit.nuisance["offset"]
    lines = (offset + pattern - scale * np.log(transmission) for transmission in transmissions)
    model = prepared.fitter.model
    errors = model.distortion(fit.nuisance, fit.linearization) + model.object_errors.lines(fit.nuisance)
    return np.stack([(line + errors).astype(np.float32) for line in lines])


def reconstructed(
    line_integrals: np.ndarray, usable: np.ndarray, geometry: OrbitGeometry, grid: Grid, mu_water: float, threads: int
) -> np.ndarray:
    """Return images by filtered back-projection, HU, shape (repeats, z, y, x); the first arguments are as in `filled`.

    `mu_water` is the attenuation of water, 1/mm.
    """
    lines = filled(line_integrals, usable)
    engine = projector("cpu", geometry, grid, len(lines), threads)
    return attenuation_to_hu(fbp(engine, lines), mu_water)


def filled(line_integrals: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Interpolate line integrals linearly along columns where rays are not usable.

    Parameters
    ----------
    line_integrals : ndarray, shape (repeats, views, rows, columns)
    usable : ndarray of bool, shape (views, rows, columns)

    Returns
    -------
    ndarray, shape (repeats, views, rows, columns)
        0 in rows without a usable ray.
    """
    if usable.all():
        return line_integrals
    lines = line_integrals.copy()
    for view, row in np.argwhere(~usable.all(axis=2)):
        good, bad = np.flatnonzero(usable[view, row]), np.flatnonzero(~usable[view, row])
        for profile in lines[:, view, row]:
            profile[bad] = np.interp(bad, good, profile[good]) if good.size else 0
    return lines
