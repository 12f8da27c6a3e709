"""Prepare a recording of images for fits: the protocol that simulates it, and the voxels that are compared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from skimage.measure import block_reduce

from ...base.errors import InputError
from ...base.geometry import Grid, ImageProtocol, OrbitGeometry
from ...base.names import enumerated, label
from ...base.streams import Branch, branch
from ...io.volumes import Volume
from ...physics.chain import Chain
from ...physics.effect import acts_on_images
from ...physics.state import AIR
from ...reconstruction.images import filters_projections, reconstruct_hu
from ...recordings.images import ImagesRecording, grid_mismatch
from ..comparison.agreement import Features
from ..comparison.regions import ScannedVolume, complete, disc_regions, phantom_regions
from ..comparison.relevance import agreement_and_changes
from ..fitting.fit import Fit
from ..fitting.nuisance import pose_of
from ..fitting.priors import BASELINE_CONFIG_KEY, declared
from ..projections.discretization import model_and_floor
from ..projections.object_errors import StatedObject
from ..request import DiagnosisRequest, NominalSettings
from ..scanned_object import MOST_SLICES, read_simulated_images, scene_of, simulated_object
from ..selection.forward_selection import Choice
from ..workload import SAMPLES
from .model import REALIZATIONS
from .other_scan import alternate_slices, placed
from .prepared import PreparedImages, prepare
from .scan import MARGIN_MM, ImagedObject, finer_scan, imaged_object

FINER = 2  # pixels, views and voxels of the images that show the error of finite ones
CUT_OFF = 2  # voxels next to constant air that are excluded
LEAST_INDEPENDENT = 4  # slices with independent noise
LEAST_CORRELATED = 0.03  # correlation of the noise of slices below which it is estimation noise
# Correlation of slices up to which they count as independent of the model, if another scan is the object. An effect
# that smooths the noise of the model then gains at most 2 x 0.05^2 = 0.5 % of the variance.
INDEPENDENT = 0.05
LEAST_DIFFERENCE_HU = 0.5  # of two scans, whose HU are whole numbers
LEAST_SLICES = 4  # fewer do not show noise correlation along z, and cannot be split for a single repeat


@dataclass(frozen=True)
class ComparedVoxels:
    """Voxels of a recording that are compared, around the isocenter; `valid` ones are seen from all directions.

    The slices `shown` of the grid `made` are reconstructed. For the others see ImagedObject.
    """

    grid: Grid
    valid: np.ndarray
    slices: slice
    window: tuple[slice, slice]
    binned: int
    made: Grid
    shown: slice

    @classmethod
    def of_phantom(cls, whole: Grid, protocol: ImageProtocol) -> ComparedVoxels:
        """Return the voxels of images of the study's phantom."""
        valid = complete(protocol.geometry, whole)
        slices = central_slices(valid)
        grid = Grid((valid[slices].shape[0], *whole.shape[1:]), whole.spacing)
        # Iterative reconstruction needs the whole object; filtered back-projection reconstructs slice by slice.
        made, shown = (grid, slice(None)) if protocol.algorithm == "fbp" else (whole, slices)
        return cls(grid, valid[slices], slices, (slice(None), slice(None)), 1, made, shown)

    @classmethod
    def of_object(cls, imaged: ImagedObject, spacing: Sequence[float], request: DiagnosisRequest) -> ComparedVoxels:
        """Return the voxels of images of an object, one slice of a prism."""
        count = 1 if imaged.prism else imaged.slices.stop - imaged.slices.start
        sides = ((part.stop - part.start) // imaged.binned for part in imaged.window)
        grid = Grid((count, *sides), (spacing[0], *(imaged.binned * step for step in spacing[1:])))
        seen = (within_field_of_view if imaged.prism else complete)(request.protocol.geometry, grid)
        valid = seen & around(grid, imaged.radius_mm, request.settings.location)
        return cls(grid, valid, imaged.slices, imaged.window, imaged.binned, grid, slice(None))

    def taken(self, repeats: Sequence[Volume], mirrored: bool) -> np.ndarray | None:
        """Return these voxels of volumes, HU, shape (repeats, z, y, x); None if there are no volumes."""
        if not len(repeats):
            return None
        found = np.stack([repeat.array[self.slices, *self.window] for repeat in repeats])
        found = block_reduce(found, (1, 1, self.binned, self.binned), np.mean).astype(np.float32)
        return found[..., ::-1] if mirrored else found


def prepare_images(recording: ImagesRecording, request: DiagnosisRequest, nominal: NominalSettings) -> PreparedImages:
    """Prepare the slices of a recording for fits. The center of the images is assumed to be the isocenter.

    Slices of an object that is constant along z become repeats of one slice.

    Raises
    ------
    InputError
        If too few slices are seen from all directions.
    """
    protocol, settings, scene = request.protocol, request.settings, scene_of(request)
    if settings.of_phantom:
        whole = replace(recording.grid, centre_mm=(0.0, 0.0, 0.0))
        of_slices, voxels = False, ComparedVoxels.of_phantom(whole, protocol)
    else:
        imaged = imaged_object(request, recording.grid)
        of_slices, voxels = imaged.prism, ComparedVoxels.of_object(imaged, recording.grid.spacing, request)
    repeats, further = (voxels.taken(part, request.mirrored) for part in (recording.repeats, recording.held_out))
    valid, slices_variance, finely, simulated = voxels.valid, None, None, None
    if of_slices:
        # Scanners set air to one value; edges next to such voxels are cut off, too.
        valid = valid & ndimage.binary_erosion(np.ptp(repeats, axis=(0, 1)) > 0, iterations=CUT_OFF)[None]
    known_error = noise_of_scan = None
    if settings.of_scan:
        # All repeats of a slice are compared with the same noise of the other scan.
        every = repeats if further is None else np.concatenate([repeats, further])
        found = compare_scans(every.mean(axis=0), recording.grid, request, voxels, valid[0])
        repeats, further, simulated, known_error = found.repeats, None, found.mean, found.error
        scene, noise_of_scan = simulated_object(request, found.modeled), found.noise
    samples = settings.samples or SAMPLES
    detector = {"sensor": nominal.sensor, "readout": AIR}
    chains = model_and_floor(scene, protocol.geometry, samples, **detector)
    reconstruct = partial(_reconstructed, protocol, request, voxels.made, voxels.shown)
    if of_slices:
        finer = finer_scan(protocol, FINER)
        chains = chains[0], Chain(scene, finer.geometry, samples=samples, **detector)
        finely = partial(_reconstructed_finely, finer, request, voxels.made)
        if settings.simulation is not None:
            finely, (shown,) = None, voxels.taken([simulated_images(request, recording)], mirrored=False)
            simulated = shown.mean(axis=0, keepdims=True)
            # Differences between simulated slices are no physics of the mean slice.
            repeats, further = (
                None if stacks is None else stacks - (shown - simulated) for stacks in (repeats, further)
            )
        slices_variance = correlated_variance(repeats, valid[0])
        repeats, further = (None if stacks is None else slices_as_repeats(stacks) for stacks in (repeats, further))
    return prepare(
        repeats,
        further,
        *chains,
        reconstruct,
        voxels.grid.spacing,
        valid,
        branch(request.seed, Branch.SIMULATED_IMAGES),
        anode=nominal.anode,
        tube_kvp=nominal.tube_kvp,
        nominal_photons=settings.nominal_photons,
        known=settings.alignment,
        declared=declared(settings.baseline, BASELINE_CONFIG_KEY),
        location=settings.location,
        slices_variance=slices_variance,
        reconstruct_finely=finely,
        known_image=simulated,
        known_error=known_error,
        noise_of_scan=noise_of_scan,
        filters=filters_projections(protocol.algorithm, protocol.settings),
        uncertain=StatedObject.of(request, scene),
    )


def simulated_images(request: DiagnosisRequest, recording: ImagesRecording) -> Volume:
    """Return the user's own simulation of a recording on its grid, HU. A single slice stands for all.

    Its mean slice is also an object that is constant along z (scanned_object.simulated_object). Effects on raw data
    change the reconstruction of this object. The model adds this change to the user's slice, and applies effects on
    images to the sum. Without effects, the model is the user's slice.

    Raises
    ------
    InputError
        If the images cannot be read or are on another grid, or if effects on images are declared.
    """
    path, grid = Path(request.settings.simulation), recording.grid
    contained = [label(name) for name in request.settings.baseline if acts_on_images(name)]
    if contained:
        raise InputError(
            f"{BASELINE_CONFIG_KEY}: simulated images contain {enumerated(contained)} already; remove this entry"
        )
    volume = read_simulated_images(path)
    if len(volume.array) > 1:
        expected = grid
    else:
        middle = (*grid.centre_mm[:2], volume.grid.centre_mm[2])
        expected = Grid((1, *grid.shape[1:]), (volume.grid.spacing[0], *grid.spacing[1:]), middle)
    if mismatch := grid_mismatch(volume.grid, expected, path, "the recording"):
        raise InputError(mismatch)
    return Volume(np.broadcast_to(volume.array, grid.shape), grid)


class ComparedScans(NamedTuple):
    """Comparison of a recording with another scan.

    Attributes
    ----------
    modeled : slice
        Slices of the other scan, among those that show the object, whose mean the model has.
    mean, error : ndarray, shape (1, y, x)
        This mean and the standard deviation of its interpolation error, HU.
    repeats : ndarray, shape (1, z, y, x)
        Recording minus other scan in the compared slices, plus `mean`, HU.
    noise : float
        See PreparedImages.noise_of_scan.
    """

    modeled: slice
    mean: np.ndarray
    error: np.ndarray
    repeats: np.ndarray
    noise: float


def compare_scans(
    recorded: np.ndarray, grid: Grid, request: DiagnosisRequest, voxels: ComparedVoxels, valid: np.ndarray
) -> ComparedScans:
    """Compare a recording with another scan.

    Parameters
    ----------
    recorded : ndarray, shape (z, y, x)
        Mean of the repeats on `voxels`, HU.
    grid : Grid
        Grid of the recording.
    valid : ndarray of bool, shape (y, x)

    Raises
    ------
    InputError
        For too few slices, or equal images.
    """
    settings, path = request.settings, request.settings.object.scan
    where = request.other_scan, grid, settings.slices, settings.location
    shown, linear = voxels.taken([placed(*where), placed(*where, order=1)], mirrored=False)
    if len(shown) < (least := 2 * LEAST_INDEPENDENT - 1):
        raise InputError(f"{path}: shows {len(shown)} slices of the recording; a comparison of scans needs {least}")
    difference = recorded - shown
    if np.abs(difference).max() < LEAST_DIFFERENCE_HU:
        raise InputError(f"{path}: has the images of the recording; give another scan of the object")
    # Along z, noise changes more than the object.
    variance, of_scan = (_variogram(one[None], valid)[2] for one in (recorded, shown))
    modeled, compared = alternate_slices(len(shown), 1 + len(slice_correlations(difference[None], valid, INDEPENDENT)))
    mean, error = (one[modeled].mean(axis=0, keepdims=True) for one in (shown, shown - linear))
    return ComparedScans(modeled, mean, error, (difference[compared] + mean)[None], math.sqrt(of_scan / variance))


def _reconstructed(
    protocol: ImageProtocol, request: DiagnosisRequest, grid: Grid, shown: slice, lines: np.ndarray, **filters
) -> np.ndarray:
    how = protocol.algorithm, protocol.settings, protocol.engine, request.mu_water_per_mm, request.threads
    return reconstruct_hu(lines.astype(np.float32), protocol.geometry, grid, *how, **filters)[:, shown]


def _reconstructed_finely(
    protocol: ImageProtocol, request: DiagnosisRequest, grid: Grid, lines: np.ndarray
) -> np.ndarray:
    """Return the means of FINER x FINER voxels for each voxel of one slice."""
    spacing = (grid.spacing[0], *(step / FINER for step in grid.spacing[1:]))
    fine = Grid((1, *(FINER * n for n in grid.shape[1:])), spacing)
    images = _reconstructed(protocol, request, fine, slice(None), lines)
    return block_reduce(images, (1, 1, FINER, FINER), np.mean)


def within_field_of_view(geometry: OrbitGeometry, grid: Grid) -> np.ndarray:
    """Return the voxels of one slice that are in the fan of every view, bool, shape (z, y, x)."""
    _, y, x = grid.axes_mm()
    radius = geometry.field_of_view_radius_mm - grid.spacing[1]
    return np.broadcast_to(np.hypot(y[:, None], x) < radius, grid.shape)


def around(grid: Grid, radius_mm: float, location: Mapping[str, float]) -> np.ndarray:
    """Return the voxels of an object and its surroundings, bool, shape (z, y, x)."""
    _, y, x = grid.axes_mm()
    y, x = y - location.get("y_mm", 0.0), x - location.get("x_mm", 0.0)
    return np.broadcast_to(np.hypot(y[:, None], x) < radius_mm + MARGIN_MM, grid.shape)


def slices_as_repeats(stacks: np.ndarray) -> np.ndarray:
    """Return slices as repeats of one slice, in order of z: from (repeats, z, y, x) to (z x repeats, 1, y, x)."""
    return np.moveaxis(stacks, 0, 1).reshape(-1, 1, *stacks.shape[2:])


def correlated_variance(stacks: np.ndarray, valid: np.ndarray) -> float:
    """Return the variance of a mean of slices, times their number, over the mean sample variance of the slices.

    Noise of neighboring slices is correlated, so their mean has more noise than with independent slices, and their
    sample variance is too small. The correlation is estimated from differences of slices (a variogram), and of
    neighboring voxels, so that slow changes of the object have no influence.

    Parameters
    ----------
    stacks : ndarray, shape (repeats, z, y, x)
        HU.
    valid : ndarray of bool, shape (y, x)

    Raises
    ------
    InputError
        If there are fewer than LEAST_INDEPENDENT independent slices.
    """
    fine, half_squares, plateau = _variogram(stacks, valid)
    count, together = fine.shape[1], 1 + 2 * sum(_correlations(half_squares, plateau, LEAST_CORRELATED))
    if count * len(stacks) / together < LEAST_INDEPENDENT:
        raise InputError(
            f"{count} slices, of which {count * len(stacks) / together:.2g} have independent noise; a "
            f"diagnosis of images needs {LEAST_INDEPENDENT}: give more slices that show the object "
            "(diagnosis.recordings: slices), or more repeats"
        )
    return plateau * together / float(fine.var(axis=1, ddof=1).mean())


def slice_correlations(stacks: np.ndarray, valid: np.ndarray, least: float) -> list[float]:
    """Return correlations of the noise of slices by their distance, from 1, up to the first below `least`.

    Other arguments are as in correlated_variance.
    """
    return _correlations(*_variogram(stacks, valid)[1:], least)


def _correlations(half_squares: Sequence[float], plateau: float, least: float) -> list[float]:
    shares = (1 - half_square / plateau if plateau else 0.0 for half_square in half_squares)
    return list(takewhile(lambda share: share > least, shares))


def _variogram(stacks: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, list[float], float]:
    """Return differences of neighboring voxels, their variogram along z, and its plateau."""
    fine = np.diff(stacks, axis=3)[..., valid[:, 1:] & valid[:, :-1]]
    count = fine.shape[1]
    lags = range(1, max(2, count // 2 + 1))
    half_squares = [float(np.mean((fine[:, lag:] - fine[:, :-lag]) ** 2)) / 2 for lag in lags] if count > 1 else [0.0]
    plateau = float(np.mean(half_squares[len(half_squares) // 2 :]))
    return fine, half_squares, plateau


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
    while away < count // 2 and not full[away : count - away].all():
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
    scanned: ScannedVolume | None,
    with_changes: bool,
) -> dict:
    """Return the agreement of the held-out repeats with simulated images of each model, as `agreement_of_repeats`.

    The simulated images of the fit are used, at most REALIZATIONS, so `purpose` has no effect.
    """
    repeats = prepared.held_out.repeats
    model, count = prepared.fitter.model, min(len(repeats), REALIZATIONS)
    pose = pose_of(choice.chosen.fit.nuisance)
    grid = Grid(repeats.shape[1:], model.spacing_mm)
    valid = prepared.data.usable | prepared.held_out.usable
    if scanned is None:
        regions = disc_regions(grid, valid, model.chain.scene, pose)
    else:
        regions = phantom_regions(grid, valid, scanned, pose)

    def images(fit: Fit) -> np.ndarray:
        return model.repeats(fit.physics, fit.nuisance, fit.linearization, count)

    # Slices of an object that is constant along z have correlated noise, simulated realizations have not.
    fit = choice.chosen.fit
    noise = model.noise_images(fit.physics, fit.nuisance, fit.linearization) if len(repeats) > 1 else None
    features = Features(regions) if scanned is not None and scanned.rois else None
    found = agreement_and_changes(repeats, images, noise, choice, regions, features, with_changes)
    return found | {"algorithm": request.protocol.algorithm}
