"""The phantom: the object that is scanned, and the regions of interest (ROIs) in which features are measured.

`synthetic.build` creates a `Phantom` from shapes, `ct.load_phantom` from a CT and its ROIs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from skimage.measure import block_reduce

from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.files import read_csv, write_csv
from ..io.volumes import Volume, read_nifti, write_nifti

HALF_COVERED = 0.5  # a voxel belongs to an ROI if the ROI covers at least this fraction of it


@dataclass(frozen=True)
class Roi:
    """A region of interest.

    Attributes
    ----------
    mask : ndarray of bool, shape (z, y, x)
        On the phantom's grid.
    label_in_file : int, str or None
        Label of the region in the user's file.
    """

    name: str
    tissue_class: str
    mask: np.ndarray = field(repr=False)
    label_in_file: int | str | None = None


@dataclass(frozen=True)
class Phantom:
    """The object in HU (float32) and its ROIs in the order of the configuration.

    Attributes
    ----------
    fine : Volume
        On the refined grid. Projecting this one avoids the inverse crime [1]_.
    image : Volume
        On the reconstruction grid: the block mean of `fine`.

    References
    ----------
    .. [1] Kaipio and Somersalo, J. Comput. Appl. Math. 198, 493, 2007.
    """

    fine: Volume
    image: Volume
    rois: tuple[Roi, ...]


def block_mean(array: np.ndarray, factor: int) -> np.ndarray:
    """Return the float32 mean over blocks of factor^3 voxels; sides of the array are multiples of `factor`."""
    return block_reduce(array, (factor,) * 3, np.mean).astype(np.float32, copy=False)


def write_phantom(phantom: Phantom, folder: str | Path) -> None:
    """Write image.nii.gz and fine.nii.gz (HU, float32), and the ROIs (`write_rois`)."""
    folder = Path(folder)
    write_nifti(phantom.fine, folder / "fine.nii.gz")
    write_nifti(phantom.image, folder / "image.nii.gz")
    write_rois(phantom.rois, phantom.image, folder)


def write_rois(rois: Sequence[Roi], image: Volume, folder: str | Path) -> None:
    """Write rois/{roi}.nii.gz (uint8, 0 or 1) and rois.csv.

    rois.csv has one row per ROI: roi, tissue_class, label (1, 2, ...), n_voxels and mean_hu on `image`. If ROIs come
    from regions of a file, label_in_file is the label in that file.
    """
    folder = Path(folder)
    rows = []
    for label, roi in enumerate(rois, start=1):
        write_nifti(Volume(roi.mask.astype(np.uint8), image.grid), folder / "rois" / f"{roi.name}.nii.gz")
        rows.append(
            {
                "roi": roi.name,
                "tissue_class": roi.tissue_class,
                "label": label,
                "n_voxels": int(roi.mask.sum()),
                "mean_hu": float(image.array[roi.mask].mean(dtype=np.float64)),
            }
        )
    table = pd.DataFrame(rows)
    if any(roi.label_in_file is not None for roi in rois):
        table["label_in_file"] = [None if roi.label_in_file is None else str(roi.label_in_file) for roi in rois]
    write_csv(table, folder / "rois.csv")


def read_masks(rois_csv: str | Path, grid: Grid) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """Read the table that `write_rois` wrote, and the masks bool [z, y, x] by ROI.

    Raises
    ------
    InputError
        If the table lacks a column, or a mask is missing or not on `grid`.
    """
    rois_csv = Path(rois_csv)
    table = read_csv(rois_csv)
    if missing := {"roi", "tissue_class"} - set(table.columns):
        raise InputError(f"{rois_csv}: lacks the column(s) {', '.join(sorted(missing))}")
    masks = {}
    for roi in table["roi"]:
        path = rois_csv.parent / "rois" / f"{roi}.nii.gz"
        mask = read_nifti(path, dtype=np.uint8)
        if not mask.grid.matches(grid):
            raise InputError(f"{path}: is on another grid ({mask.grid}) than the images ({grid})")
        masks[roi] = mask.array > 0
    return table, masks


def images_with_rois(
    image_files: Sequence[str | Path], rois_files: Sequence[str | Path]
) -> Iterator[tuple[Volume, dict[str, np.ndarray], dict[str, str]]]:
    """Read images with the masks and tissue classes of their ROIs, {ROI: mask} and {ROI: class}.

    ROIs are read again only for an image with another table than the one before.

    Raises
    ------
    InputError
        As `read_masks`, or if an image is on another grid than its ROIs.
    """
    known = None
    for path, rois_csv in zip(image_files, rois_files, strict=True):
        image = read_nifti(path)
        if rois_csv != known:
            table, masks = read_masks(rois_csv, image.grid)
            classes = dict(zip(table["roi"], table["tissue_class"], strict=True))
            grid, known = image.grid, rois_csv
        if not image.grid.matches(grid):
            raise InputError(f"{path}: is on another grid ({image.grid}) than the ROIs ({grid})")
        yield image, masks, classes


def read_rois(rois_csv: str | Path, grid: Grid) -> tuple[Roi, ...]:
    """Read the ROIs that `write_rois` wrote, with the same checks as `read_masks`."""
    table, masks = read_masks(rois_csv, grid)
    labels = table["label_in_file"] if "label_in_file" in table else [None] * len(table)
    return tuple(
        Roi(name, tissue_class, masks[name], None if pd.isna(label) else label)
        for name, tissue_class, label in zip(table["roi"], table["tissue_class"], labels, strict=True)
    )
