"""Volumes on a Grid, and NIfTI files of them."""

from __future__ import annotations

import contextlib
import gzip
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import nibabel
import numpy as np

from ..base.errors import InputError, refusing
from ..base.geometry import Grid
from .files import check_unchanged, replacing

SMALLEST_VOXEL_MM3 = 1e-9
CHUNK = 1 << 20  # bytes
GZIP_MOST = 1032  # bytes that one of deflate's stands for at most: 258 of them in 2 bits (RFC 1951)


@dataclass(frozen=True)
class Volume:
    """An array and the grid that says where its voxels are.

    Attributes
    ----------
    array : ndarray, shape (z, y, x)
        Values of the voxels.
    grid : Grid
        Of the same shape.

    Raises
    ------
    ValueError
        If the shapes differ.
    """

    array: np.ndarray
    grid: Grid

    def __post_init__(self):
        if self.array.shape != self.grid.shape:
            raise ValueError(f"array of shape {self.array.shape} on a grid of shape {self.grid.shape}")


def read_nifti(path: str | Path, dtype=np.float32) -> Volume:
    """Read a 3D NIfTI image, its axes flipped and swapped to run along +x, +y, +z.

    Parameters
    ----------
    path : str or Path
    dtype : dtype or None, optional
        Of the result; None: that of the file.

    Returns
    -------
    Volume

    Raises
    ------
    InputError
        If the file is missing, truncated, not 3D, or its axes are tilted against the scanner's.
    """
    with _opened(Path(path)) as image:
        array, affine = np.asarray(image.dataobj), image.affine
    return upright(array, affine, path, dtype)


def length_unit(path: str | Path) -> str:
    """The unit of lengths in the header of a NIfTI image.

    The header alone is read: the rest is for read_nifti to check.

    Returns
    -------
    str
        As NiBabel names it, such as "mm", or "unknown".

    Raises
    ------
    InputError
        If the file is missing or has no NIfTI header.
    """
    with _opened(Path(path), whole=False) as image:
        return image.header.get_xyzt_units()[0]


def shape_of(path: str | Path) -> tuple[int, ...]:
    """Voxels of an image along z, y and x as they are stored, without reading them.

    Returns
    -------
    tuple of int

    Raises
    ------
    InputError
        If the file is missing or has no NIfTI header.
    """
    with _opened(Path(path), whole=False) as image:
        return image.shape[::-1]


@contextlib.contextmanager
def _opened(path: Path, whole: bool = True) -> Iterator[nibabel.Nifti1Image]:
    """Open a NIfTI-1 or NIfTI-2 image, its voxels not yet read. No other format is tried.

    Parameters
    ----------
    path : Path
    whole : bool, optional
        Check that the file is as it was written, and read it to its end: gzip's own checksum stands there, and nibabel
        stops at the last voxel.

    Yields
    ------
    nibabel.Nifti1Image

    Raises
    ------
    InputError
        If the file is missing, changed, or cannot be read as NIfTI.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a NIfTI image")
    if whole:
        check_unchanged(path)
    # nibabel raises many types on broken files.
    with refusing(f"{path}: cannot be read as NIfTI", Exception, advice="is the file complete?"):
        with (gzip.open if path.name.endswith(".gz") else open)(path, "rb") as stream:
            image = _class_of(stream).from_stream(stream)
            _check_size(image, path)
            yield image
            while whole and stream.read(CHUNK):
                pass


def _class_of(stream: BinaryIO) -> type:
    """NIfTI-1 or NIfTI-2 by the size that the header gives itself, in either byte order."""
    start = stream.read(4)
    stream.seek(0)
    for kind, size in ((nibabel.Nifti1Image, 348), (nibabel.Nifti2Image, 540)):
        if start in (size.to_bytes(4, "little"), size.to_bytes(4, "big")):
            return kind
    raise ValueError("no NIfTI header")


def _check_size(image: nibabel.Nifti1Image, path: Path) -> None:
    """Refuse a header that asks for more than the file can hold, or the machine, before anything is allocated."""
    voxels = math.prod(map(int, image.shape))
    claimed = voxels * image.header.get_data_dtype().itemsize
    most = path.stat().st_size * (GZIP_MOST if path.name.endswith(".gz") else 1)
    if min(image.shape, default=0) < 1 or claimed > most:
        size = " x ".join(map(str, image.shape))
        raise InputError(f"{path}: its header says {size} voxels, which the file does not hold; is the file complete?")
    check_fits(max(claimed, 4 * voxels), path)


def check_fits(needed: int, source: str | Path) -> None:
    """Check that an array fits into the machine's memory.

    Parameters
    ----------
    needed : int
        Bytes of the array.
    source : str or Path
        What the message begins with: the file or the section.

    Raises
    ------
    InputError
        If it does not.
    """
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise InputError(
            f"{source}: asks for {needed / 1e9:.3g} GB of memory, the machine has {there / 1e9:.3g}; make it smaller"
        )


def upright(array: np.ndarray, affine: np.ndarray, path: str | Path, dtype=np.float32) -> Volume:
    """The volume of an array and its affine, axes flipped and swapped to run along +x, +y, +z.

    Parameters
    ----------
    array : ndarray, shape (x, y, z) or (x, y, z, 1)
        Numbers.
    affine : ndarray, shape (4, 4)
        From voxel index to RAS world mm.
    path : str or Path
        What the message begins with.
    dtype : dtype or None, optional
        Of the result; None: that of the array.

    Returns
    -------
    Volume

    Raises
    ------
    InputError
        If the array is not 3D or no numbers, or its axes are tilted against the scanner's or have no size.
    """
    if array.dtype.kind not in "biuf":
        raise InputError(f"{path}: its voxels are of {array.dtype}, not numbers; give grey values")
    if array.ndim == 4 and array.shape[3] == 1:
        array = array[..., 0]
    if array.ndim != 3:
        raise InputError(f"{path}: has {array.ndim} dimensions; give a 3D image")
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:3, :3])) < SMALLEST_VOXEL_MM3:
        raise InputError(f"{path}: its header gives voxels no size or place; repair its affine")
    orientation = nibabel.io_orientation(affine)
    if np.isnan(orientation).any():
        raise InputError(f"{path}: its header gives two axes one direction; repair its affine")
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
    """Write a volume as NIfTI-1 in mm, its affine in both sform and qform.

    The gzip header carries no time or name, so equal volumes make equal bytes.

    Parameters
    ----------
    volume : Volume
        Of float32, or any integer type.
    path : str or Path
    """
    image = nibabel.Nifti1Image(volume.array.T, volume.grid.affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(volume.grid.affine, code="scanner")
    image.set_qform(volume.grid.affine, code="scanner")
    with replacing(path) as temporary:
        nibabel.save(image, temporary)


def read_repeats(paths: Sequence[str | Path]) -> tuple[np.ndarray, Grid]:
    """Images of one scan.

    Parameters
    ----------
    paths : sequence of str or Path
        NIfTI files.

    Returns
    -------
    images : ndarray of float64, shape (repeats, z, y, x)
        Their voxels.
    grid : Grid
        Of all of them.

    Raises
    ------
    InputError
        If one lies on another grid than the first.
    """
    repeats = [read_nifti(path) for path in paths]
    grid = repeats[0].grid
    if odd := [path for path, one in zip(paths, repeats, strict=True) if not one.grid.matches(grid)]:
        raise InputError(f"{odd[0]}: is on another grid than {paths[0]}; make the images again")
    return np.stack([one.array for one in repeats]).astype(np.float64), grid
