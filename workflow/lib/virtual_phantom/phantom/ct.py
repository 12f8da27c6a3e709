"""Create a phantom from a CT in HU and the regions drawn on it, resampled to the grid of the study."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from scipy.ndimage import find_objects

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.pose import IN_PLACE, Pose
from ..base.settings import CtPhantom, RoiEntry, from_mapping
from ..base.units import HU_AIR, HU_BODY
from ..io.schema import fill_defaults, schema_of, validate
from ..io.simpleitk import itk_image, itk_resample
from ..io.volumes import IMAGE_SUFFIXES, Volume, length_unit, read_image, suffix_of
from . import HALF_COVERED, Phantom, Roi, block_mean
from .dicom_files import not_dicom
from .dicom_series import read_series
from .grid_size import suggest_size
from .masks import open_regions
from .plausibility import CHECKS, SIZE, require_plausible
from .repositioning import world_to_object
from .rois import cut, read_roi_entries, separate, shrink

LARGEST_LOSS = 0.01  # fraction of an ROI that keep_mm or the grid may cut off, because a box is rounded to voxels
SLAB_SLICES = 4  # slices that are resampled at a time, to limit memory


def read_settings(section: Mapping) -> CtPhantom:
    """Check a section phantom.ct with its schema and return it with defaults."""
    schema, section = schema_of("phantom", "ct"), copy.deepcopy(dict(section))
    validate(section, schema, "phantom: ct")
    fill_defaults(section, schema)
    return from_mapping(CtPhantom, section)


def load_phantom(settings: CtPhantom, grid: Grid, oversampling: int) -> Phantom:
    """Load a CT and its ROIs.

    The CT is interpolated linearly at points at least as dense as its voxels, then averaged to the refined grid and to
    the grid. Values below air, and voxels outside the CT, are set to air. A voxel belongs to an ROI if the ROI covers
    at least half of it. Parts of one region are separated by one voxel.

    Parameters
    ----------
    grid : Grid
        Shape and spacing; the center is set to centre_mm.
    oversampling : int
        Refinement of the grid of `Phantom.fine`.

    Raises
    ------
    InputError
        If the image, a region or a setting is unusable, or the body does not fit the grid in-plane. Also if an ROI is
        empty on the grid, or loses more than LARGEST_LOSS of its volume to keep_mm or the border of the grid.
    """
    entries = read_roi_entries(settings.rois, settings.labels)
    if settings.image is None:
        raise InputError("phantom: ct: image is missing; name a NIfTI file, or the folder of a DICOM series")
    image = read_hu(Path(settings.image), settings.not_checked or ())
    image = Volume(np.maximum(image.array, np.float32(HU_AIR)), image.grid)
    kept = np.ones(image.grid.shape[1:], bool)
    if settings.keep_mm:
        kept = kept_columns(settings.keep_mm, image.grid)
        image = trimmed(image, settings.keep_mm)
    grid = replace(grid, centre_mm=settings.centre_mm or image.grid.centre_mm)
    check_fit(image, grid)
    fine = resample(image, grid.refined(oversampling), outside=HU_AIR)
    opened: dict = {}
    rois = tuple(roi for entry in entries for roi in make_rois(entry, image.grid, grid, kept, opened))
    return Phantom(Volume(fine, grid.refined(oversampling)), Volume(block_mean(fine, oversampling), grid), rois)


def rois(settings: CtPhantom, grid: Grid, pose: Pose = IN_PLACE) -> tuple[Roi, ...]:
    """Make the ROIs of a CT phantom on a grid in world coordinates, after moving the phantom to a pose."""
    image, opened = read_hu(Path(settings.image), CHECKS).grid, {}  # `load_phantom` checks the values
    kept = np.ones(image.shape[1:], bool)
    if settings.keep_mm:
        kept = kept_columns(settings.keep_mm, image)
    entries = read_roi_entries(settings.rois, settings.labels)
    return tuple(roi for entry in entries for roi in make_rois(entry, image, grid, kept, opened, pose))


def read_hu(path: Path, not_checked: Collection[str] = ()) -> Volume:
    """Read a CT in HU from a NIfTI, NRRD or MetaImage file, or the folder of one DICOM series.

    Parameters
    ----------
    not_checked : collection of str, optional
        Members of plausibility.CHECKS that are skipped.

    Raises
    ------
    InputError
        If it cannot be read, has voxels that are not finite, or fails `check_hu`.
    """
    if path.is_dir():
        image = read_series(path)
    elif suffix_of(path):
        image = read_image(path)
    elif path.is_file():
        problem = not_dicom(path)
        kind = "one DICOM file; give the folder of its series" if not problem else problem
        raise InputError(f"{path}: is {kind} (or a NIfTI, NRRD or MetaImage file: {', '.join(IMAGE_SUFFIXES)})")
    else:
        raise InputError(
            f"{path}: no such CT; give a NIfTI, NRRD or MetaImage file ({', '.join(IMAGE_SUFFIXES)}) or the folder of "
            "a DICOM series"
        )
    if bad := int(np.count_nonzero(~np.isfinite(image.array))):
        raise InputError(f"{path}: {bad} voxels are NaN or infinite; replace them (air is -1000 HU)")
    check_hu(image, path, not_checked)
    return image


def check_hu(image: Volume, path: Path, not_checked: Collection[str] = ()) -> None:
    """Check that the values and lengths of an image can be in HU and mm.

    Raises
    ------
    InputError
        If the header gives another unit of length than mm.
    InputErrors
        A line for each check of plausibility.require_plausible that fails.
    """
    if SIZE not in not_checked and not path.is_dir() and (unit := length_unit(path)) not in ("mm", "unknown"):
        raise InputError(f"{path}: its header gives lengths in {unit}; write it in mm")
    require_plausible(image.array, image.grid, path, not_checked)


def _world_axes(grid: Grid) -> tuple[np.ndarray, ...]:
    return tuple(axis + centre for axis, centre in zip(grid.axes_mm(), grid.centre_mm[::-1], strict=True))


def trimmed(image: Volume, keep_mm: Sequence[Sequence[float]]) -> Volume:
    """Set an image to air outside the box keep_mm, with the same checks as `kept_columns`."""
    return Volume(np.where(kept_columns(keep_mm, image.grid), image.array, np.float32(HU_AIR)), image.grid)


def kept_columns(keep_mm: Sequence[Sequence[float]], grid: Grid) -> np.ndarray:
    """Return which columns of voxels along z of the CT grid, bool [y, x], have their center in keep_mm.

    Parameters
    ----------
    keep_mm : sequence of 2 sequence of 2 float
        Box [[x, x], [y, y]] in NIfTI world mm.

    Raises
    ------
    InputError
        If no column is in the box.
    """
    (x_low, x_high), (y_low, y_high) = keep_mm
    _, y, x = _world_axes(grid)
    inside = ((y >= y_low) & (y <= y_high))[:, None] & ((x >= x_low) & (x <= x_high))
    if not inside.any():
        raise InputError(
            f"phantom: ct: keep_mm {[list(pair) for pair in keep_mm]} leaves nothing of the CT; it spans "
            f"x {x[0]:g} to {x[-1]:g} and y {y[0]:g} to {y[-1]:g} mm"
        )
    return inside


def check_fit(image: Volume, grid: Grid) -> None:
    """Check that the body in a CT fits a grid in-plane.

    Parameters
    ----------
    image : Volume
        The CT in HU, after `trimmed`.

    Raises
    ------
    InputError
        If the body does not fit, the grid does not overlap the CT along z, or there is no body within the grid.
    """
    z, y, x = _world_axes(image.grid)
    half_z, half_y, half_x = (extent / 2 for extent in grid.extent_mm)
    center_x, center_y, center_z = grid.centre_mm
    seen = np.abs(z - center_z) <= half_z + image.grid.spacing[0] / 2
    if not seen.any():
        raise InputError(f"phantom: ct: the grid ({grid}) misses the CT ({image.grid}) along z; correct centre_mm")
    body = (image.array[seen] > HU_BODY).any(axis=0)
    if not body.any():
        raise InputError(f"phantom: ct: nothing in the CT is denser than {HU_BODY:g} HU within the grid; is it in HU?")
    rows, columns = np.nonzero(body)
    reach_x = float(np.abs(x[columns] - center_x).max()) + image.grid.spacing[2] / 2
    reach_y = float(np.abs(y[rows] - center_y).max()) + image.grid.spacing[1] / 2
    if reach_x > half_x + 1e-3 or reach_y > half_y + 1e-3:
        needed = (0.0, 2 * reach_y, 2 * reach_x)
        advice = suggest_size(grid, needed, (image.grid.extent_mm[0], *needed[1:]))
        raise InputError(
            f"grid: the body in the CT does not fit. Around centre_mm ({center_x:g}, {center_y:g}, {center_z:g}) "
            f"(x, y, z) it needs {2 * reach_y:.0f} mm along y and {2 * reach_x:.0f} mm along x. The grid spans "
            f"{2 * half_y:.0f} and {2 * half_x:.0f} mm; {advice}, or set phantom.ct.keep_mm to remove table and arms"
        )


def draw_entry(entry: RoiEntry, grid: Grid, opened: dict) -> list[np.ndarray]:
    """Return a mask, bool [z, y, x], for each part of an entry on the grid of the CT.

    Parameters
    ----------
    opened : dict
        Cache of opened region files, by name.

    Raises
    ------
    InputError
        If the file or label does not exist, or the region is empty, also after its margin is removed.
    """
    if entry.file not in opened:
        opened[entry.file] = open_regions(entry.file, grid)
    region = opened[entry.file].mask(entry.label, entry.fill_gaps)
    _require(region, entry.name, f"is empty in {entry.file}; draw it, or correct its label")
    region = shrink(region, entry.margin_mm, grid)
    _require(region, entry.name, f"is lost by margin_mm {entry.margin_mm:g}; make it smaller")
    return cut(region, entry.parts, grid)


def make_rois(
    entry: RoiEntry, ct_grid: Grid, grid: Grid, kept: np.ndarray, opened: dict, pose: Pose = IN_PLACE
) -> tuple[Roi, ...]:
    """Make an ROI on the grid of the study for each part of an entry.

    Parameters
    ----------
    grid : Grid
        Grid of the study, in world coordinates.
    kept : ndarray of bool, shape (y, x)
        Columns of the CT within keep_mm.
    opened : dict
        Cache of opened region files, by name.

    Raises
    ------
    InputError
        As `draw_entry`, or if the ROI is cut off or has no voxel on the grid.
    """
    pieces = draw_entry(entry, ct_grid, opened)
    for name, piece in zip(entry.names, pieces, strict=True):
        _check_cut_off(name, piece, kept, ct_grid, grid)
    moved = world_to_object(pose, grid.centre_mm)
    masks = [resample(_around(piece, ct_grid), grid, 0.0, moved) >= HALF_COVERED for piece in pieces]
    for name, mask in zip(entry.names, masks, strict=True):
        _require(mask, name, "fills no voxel of the grid by half; use a finer grid, a smaller margin_mm or fewer parts")
    separated = separate(masks)
    for name, mask in zip(entry.names, separated, strict=True):
        _require(mask, name, f"is lost between its neighbors when cut into {entry.parts} parts; give fewer")
    named = zip(entry.names, separated, strict=True)
    return tuple(Roi(name, entry.tissue_class, mask, entry.label) for name, mask in named)


def _around(mask: np.ndarray, grid: Grid) -> Volume:
    """Crop a mask to its region with a margin of one voxel, which the interpolation needs."""
    boxes = find_objects(mask.astype(np.uint8))
    if not boxes:
        return Volume(mask.astype(np.float32), grid)
    box = tuple(slice(max(s.start - 1, 0), min(s.stop + 1, n)) for s, n in zip(boxes[0], mask.shape, strict=True))
    centre = tuple(float(axis[part].mean()) for axis, part in zip(_world_axes(grid), box, strict=True))[::-1]
    part = mask[box].astype(np.float32)
    return Volume(part, replace(grid, shape=part.shape, centre_mm=centre))


def _check_cut_off(name: str, piece: np.ndarray, kept: np.ndarray, ct_grid: Grid, grid: Grid) -> None:
    """Check that neither keep_mm nor the border of the grid cuts off more than LARGEST_LOSS of an ROI on the CT."""
    voxels = np.count_nonzero(piece)
    if voxels == 0:
        return  # reported later, as it fills no voxel of the grid
    lost = np.count_nonzero(piece & ~kept) / voxels
    if lost > LARGEST_LOSS:
        raise InputError(
            f"ROI {name}: {100 * lost:.3g} % of it lies outside phantom.ct.keep_mm and would become air; widen "
            "keep_mm, or draw the ROI within it"
        )
    z, y, x = _shares_inside(ct_grid, grid)
    (box,) = find_objects(piece.astype(np.uint8))
    inside = np.einsum("zyx,z,y,x->", piece[box], z[box[0]], y[box[1]], x[box[2]], optimize=True)
    lost = 1 - float(inside) / voxels
    if lost > LARGEST_LOSS:
        raise InputError(
            f"ROI {name}: {100 * lost:.3g} % of it lies outside the grid; enlarge grid.shape or grid.spacing_mm, move "
            "phantom.ct.centre_mm, or draw the ROI within the grid"
        )


def _shares_inside(ct_grid: Grid, grid: Grid) -> list[np.ndarray]:
    """Return the fraction of each voxel of the CT within the grid, along z, y and x."""
    shares = []
    for centers, step, middle, extent in zip(
        _world_axes(ct_grid), ct_grid.spacing, grid.centre_mm[::-1], grid.extent_mm, strict=True
    ):
        low = np.maximum(centers - step / 2, middle - extent / 2)
        high = np.minimum(centers + step / 2, middle + extent / 2)
        shares.append(np.clip((high - low) / step, 0, 1))
    return shares


def _require(mask: np.ndarray, name: str, problem: str) -> None:
    if not mask.any():
        raise InputError(f"ROI {name} {problem}")


def resample(volume: Volume, grid: Grid, outside: float, transform: sitk.Transform | None = None) -> np.ndarray:
    """Return the mean of the linearly interpolated volume over each voxel of a grid, as float32.

    Sample points are at most one voxel of the volume apart.

    Parameters
    ----------
    outside : float
        Value outside the volume.
    transform : SimpleITK.Transform, optional
        From the world of the result to the world of the volume; by default the identity.
    """
    samples = max(math.ceil(to / of - 1e-6) for to, of in zip(grid.spacing, volume.grid.spacing, strict=True))
    image = itk_image(volume.array, volume.grid)
    result = np.empty(grid.shape, np.float32)
    for first in range(0, grid.shape[0], SLAB_SLICES):
        last = min(first + SLAB_SLICES, grid.shape[0])
        middle = grid.centre_mm[2] + ((first + last) / 2 - grid.shape[0] / 2) * grid.spacing[0]
        slab = replace(grid, shape=(last - first, *grid.shape[1:]), centre_mm=(*grid.centre_mm[:2], middle)).refined(
            samples
        )
        part = itk_resample(image, slab, transform or sitk.Transform(), outside)
        result[first:last] = block_mean(part, samples)
    return result
