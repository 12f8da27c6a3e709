"""Volumes on a Grid, and NIfTI files of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import nibabel
import numpy as np

from .errors import InputError
from .files import replacing
from .geometry import Grid


@dataclass(frozen=True)
class Volume:
    """An array [z, y, x] and the grid that says where its voxels are."""

    array: np.ndarray
    grid: Grid

    def __post_init__(self):
        if self.array.shape != self.grid.shape:
            raise ValueError(f"array of shape {self.array.shape} on a grid of shape {self.grid.shape}")


def read_nifti(path: str | Path, dtype=np.float32) -> Volume:
    """Read a 3D NIfTI image, its axes flipped and swapped to run along +x, +y, +z.

    Raises InputError if the file is missing, truncated, not 3D, or its axes are tilted against the scanner's.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; give the path of a NIfTI image")
    try:
        image = nibabel.load(path)
        array, affine = np.asarray(image.dataobj), image.affine
    except Exception as error:  # nibabel raises many types on broken files
        raise InputError(f"{path}: cannot be read as NIfTI ({error}); is the file complete?") from error
    return upright(array, affine, path, dtype)


def upright(array: np.ndarray, affine: np.ndarray, path: str | Path, dtype=np.float32) -> Volume:
    """The volume of an array [x, y, z] and its RAS affine, axes flipped and swapped to run along +x, +y, +z.

    Raises InputError, naming `path`, if the array is not 3D or its axes are tilted against the scanner's.
    """
    if array.ndim == 4 and array.shape[3] == 1:
        array = array[..., 0]
    if array.ndim != 3:
        raise InputError(f"{path}: has {array.ndim} dimensions; give a 3D image")
    orientation = nibabel.io_orientation(affine)
    affine = affine @ nibabel.orientations.inv_ornt_aff(orientation, array.shape)
    array = nibabel.apply_orientation(array, orientation)
    matrix = affine[:3, :3]
    spacing = np.linalg.norm(matrix, axis=0)
    if np.any(np.abs(matrix - np.diag(spacing)) > 1e-3 * spacing.min()):
        raise InputError(f"{path}: its axes are tilted against the scanner's; resample it upright first")
    centre = affine[:3, 3] + matrix @ ((np.array(array.shape) - 1) / 2)
    grid = Grid(shape=array.shape[::-1], spacing=tuple(spacing[::-1]), centre_mm=tuple(centre))
    return Volume(np.ascontiguousarray(array.T, dtype=dtype), grid)


def write_nifti(volume: Volume, path: str | Path) -> None:
    """Write a volume (float32, or any integer type) as NIfTI-1 in mm, its affine in both sform and qform.

    The gzip header carries no time or name, so equal volumes make equal bytes.
    """
    image = nibabel.Nifti1Image(volume.array.T, volume.grid.affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(volume.grid.affine, code="scanner")
    image.set_qform(volume.grid.affine, code="scanner")
    with replacing(path) as temporary:
        nibabel.save(image, temporary)


def read_repeats(paths: Sequence[str | Path]) -> tuple[np.ndarray, Grid]:
    """Images of one scan, float64 [repeat, z, y, x], and their grid.

    Raises InputError if one lies on another grid than the first.
    """
    repeats = [read_nifti(path) for path in paths]
    grid = repeats[0].grid
    if odd := [path for path, one in zip(paths, repeats, strict=True) if not one.grid.matches(grid)]:
        raise InputError(f"{odd[0]}: is on another grid than {paths[0]}; make the images anew")
    return np.stack([one.array for one in repeats]).astype(np.float64), grid
