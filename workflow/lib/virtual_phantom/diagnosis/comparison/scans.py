"""Agreement of a recording with models of it, in images that are reconstructed alike."""

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
from .regions import Scanned, complete, disc_regions, image_grid, phantom_regions
from .relevance import agreement_and_practice

NOISE = 0  # branch of the seed that simulated noise is drawn from


def agreement_of_scans(
    recording: Recording,
    prepared: PreparedScans,
    choice: Choice,
    asked: DiagnosisRequest,
    purpose: Branch,
    scanned: Scanned | None = None,
    practice: bool = False,
) -> dict:
    """`agreement_of` the repeats held out, in images made of them.

    Parameters
    ----------
    purpose : Branch
        What simulated noise is drawn for.
    scanned : Scanned, optional
        None for a disc.
    practice : bool, optional
        As agreement_of takes it.
    """
    further = scans(recording.held_out) if len(recording.held_out) else None
    repeats = compared(scans(recording.repeats), further).every(prepared.step)
    seed = branch(asked.seed, purpose)
    return agreement_of(repeats, prepared, choice, asked.mu_water_per_mm, seed, scanned, asked.threads, practice)


def agreement_of(
    repeats: Scans,
    prepared: PreparedScans,
    choice: Choice,
    mu_water_per_mm: float,
    seed: Stream,
    scanned: Scanned | None = None,
    threads: int = 1,
    practice: bool = False,
) -> dict:
    """Agreement of repeats of projections, in images (images.agreement.agreement).

    "before" is the model with nothing but alignment, "after" the chosen one, each drawn as often as there are repeats,
    with the same random numbers: what is between them is no chance. All are reconstructed by filtered back-projection.
    Edge and ROIs lie where the chosen model puts the object; features are those of the study's ROIs.

    Parameters
    ----------
    repeats : Scans
        See `compared`.
    mu_water_per_mm : float
        1/mm.
    seed : Stream
        Of simulated noise.
    scanned : Scanned, optional
        None for a disc.
    practice : bool, optional
        Whether it is told what effects change in images (images.practice.told), which takes a reconstruction of each.

    Returns
    -------
    dict
        That of images.agreement.agreement, with rois (names), repeats (number), algorithm and grid, and, if asked for,
        practice. Where the scan cannot be reconstructed, there are no metrics but the reason.
    """
    chain = prepared.fitter.model.chain
    pose = pose_of(choice.chosen.fit.nuisance)
    try:
        radius = chain.scene.radius_mm if scanned is None else scanned.radius_mm
        grid = image_grid(chain.geometry, radius)
        valid = complete(chain.geometry, grid)
        if scanned is None:
            regions = disc_regions(grid, valid, chain.scene, pose)
        else:
            regions = phantom_regions(grid, valid, scanned, pose)
        reconstruct = Reconstruction(chain.geometry, grid, mu_water_per_mm, repeats.usable, threads)
        recorded = reconstruct(repeats.repeats)
    except InputError as error:
        return {"metrics": {}, "left_out": {"images": str(error)}}

    def images(fit: Fit) -> np.ndarray:
        # A stream anew for each: what has been drawn from it counts its branches.
        return reconstruct(simulated_repeats(prepared, fit, len(repeats), generator(below(seed, NOISE))))

    features = Features(regions) if scanned is not None and scanned.rois else None
    return agreement_and_practice(recorded, images, choice, regions, features, practice) | {
        "algorithm": "fbp",
        "grid": {"shape": list(grid.shape), "spacing_mm": list(grid.spacing)},
    }


def compared(taken: Scans, further: Scans | None) -> Scans:
    """The repeats that were held out (prepared.split); all of them where every second view was held out instead."""
    if not further and len(taken) < HALVES:
        return taken
    return split(taken, further)[1]


def simulated_repeats(prepared: PreparedScans, fit: Fit, count: int, random: np.random.Generator) -> np.ndarray:
    """Noisy line integrals of a fitted model with its alignment and gain pattern.

    Returns
    -------
    ndarray of float32, shape (count, views, rows, columns)
    """
    state = prepared.fitter.predicted(fit, held_out=True).state
    air = state.measured_air * state.photons
    pattern = 0.0 if fit.pattern is None else fit.pattern
    transmissions = (np.maximum(state.counts(random) / air, LEAST_TRANSMISSION) for _ in range(count))
    lines = (fit.nuisance["offset"] + pattern - fit.nuisance["scale"] * np.log(one) for one in transmissions)
    numerical = prepared.fitter.model.distortion(fit.nuisance, fit.linearisation)
    return np.stack([(one + numerical).astype(np.float32) for one in lines])


class Reconstruction:
    """Filtered back-projection of stacks of line integrals onto one grid.

    Parameters
    ----------
    mu_water_per_mm : float
        1/mm.
    usable : ndarray of bool, shape (views, rows, columns)
        The other rays take values between their neighbours', in recordings and simulations.
    """

    def __init__(
        self, geometry: OrbitGeometry, grid: Grid, mu_water_per_mm: float, usable: np.ndarray, threads: int = 1
    ):
        self.geometry, self.grid, self.mu_water_per_mm = geometry, grid, mu_water_per_mm
        self.usable, self.threads = usable, threads

    def __call__(self, line_integrals: np.ndarray) -> np.ndarray:
        """Images of line integrals.

        Parameters
        ----------
        line_integrals : ndarray, shape (repeats, views, rows, columns)

        Returns
        -------
        ndarray, shape (repeats, z, y, x)
            HU.

        Raises
        ------
        InputError
            As fbp.
        """
        lines = filled(line_integrals, self.usable)
        engine = projector("cpu", self.geometry, self.grid, len(lines), self.threads)
        return attenuation_to_hu(fbp(engine, lines), self.mu_water_per_mm)


def filled(line_integrals: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Line integrals, interpolated linearly along the columns where rays are not usable.

    Parameters
    ----------
    line_integrals : ndarray, shape (repeats, views, rows, columns)
    usable : ndarray of bool, shape (views, rows, columns)

    Returns
    -------
    ndarray, shape (repeats, views, rows, columns)
        0 where a whole row is not usable.
    """
    if usable.all():
        return line_integrals
    lines = line_integrals.copy()
    for view, row in np.argwhere(~usable.all(axis=2)):
        good, bad = np.flatnonzero(usable[view, row]), np.flatnonzero(~usable[view, row])
        for one in lines[:, view, row]:
            one[bad] = np.interp(bad, good, one[good]) if good.size else 0
    return lines
