"""The phantom: what is scanned, and the regions in which features are measured.

`synthetic.build` makes one from shapes; `ct.load` makes one from a CT and its ROIs. Both give the same
`Phantom`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from skimage.measure import block_reduce

from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.files import read_csv, write_csv
from ..io.volumes import Volume, read_nifti, write_nifti

HALF_COVERED = 0.5  # a voxel of the grid belongs to an ROI if at least this share of it does


@dataclass(frozen=True)
class Roi:
    """A region of interest.

    Attributes
    ----------
    mask : ndarray of bool, shape (z, y, x)
        On the phantom's grid.
    label_in_file : int, str or None
        Which region of a user's file it was made from.
    """

    name: str
    tissue_class: str
    mask: np.ndarray
    label_in_file: int | str | None = None


@dataclass(frozen=True)
class Phantom:
    """What is scanned, in HU (float32), and where features are measured.

    Attributes
    ----------
    fine : Volume
        On the grid refined by the oversampling: projections are taken of this one, so that the reconstruction does not
        meet its own voxels again.
    image : Volume
        On the reconstruction grid: the block mean of `fine`.
    rois : tuple of Roi
        In the order of the configuration.

    References
    ----------
    Kaipio and Somersalo, J. Comput. Appl. Math. 198, 493, 2007.
    """

    fine: Volume
    image: Volume
    rois: tuple[Roi, ...]


def block_mean(array: np.ndarray, factor: int) -> np.ndarray:
    """Mean over blocks of voxels.

    Parameters
    ----------
    array : ndarray, shape (z, y, x)
        Its sides are multiples of `factor`.
    factor : int
        Voxels along each side of a block.

    Returns
    -------
    ndarray of float32, shape (z / factor, y / factor, x / factor)
    """
    return block_reduce(array, (factor,) * 3, np.mean).astype(np.float32, copy=False)


def save(phantom: Phantom, folder: str | Path) -> None:
    """Write image.nii.gz and fine.nii.gz (HU, float32), and the ROIs as save_rois does."""
    folder = Path(folder)
    write_nifti(phantom.fine, folder / "fine.nii.gz")
    write_nifti(phantom.image, folder / "image.nii.gz")
    save_rois(phantom.rois, phantom.image, folder)


def save_rois(rois: Sequence[Roi], image: Volume, folder: str | Path) -> None:
    """Write rois/{roi}.nii.gz (uint8, 0 or 1) and rois.csv.

    rois.csv holds one row per ROI: roi, tissue_class, label (1, 2, ... in the order of the configuration),
    n_voxels and mean_hu on `image`, and, where ROIs were made from regions of a file, label_in_file, their label there;
    parts of one region share it.

    Parameters
    ----------
    image : Volume
        HU, on the grid of the ROIs.
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
    """Read the ROIs that `save` wrote.

    Parameters
    ----------
    rois_csv : str or Path
        The table; masks lie in rois/ beside it.
    grid : Grid
        Where the masks must be.

    Returns
    -------
    table : DataFrame
        Of ROIs: roi, tissue_class, ...
    masks : dict of str to ndarray of bool, shape (z, y, x)
        By name.

    Raises
    ------
    InputError
        If the table lacks a column, or a mask is missing or on another grid than `grid`.
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


def read_rois(rois_csv: str | Path, grid: Grid) -> tuple[Roi, ...]:
    """The same as `Roi`s, in the table's order.

    Parameters
    ----------
    grid : Grid
        Where the masks must be.

    Raises
    ------
    InputError
        As `read_masks`.
    """
    table, masks = read_masks(rois_csv, grid)
    labels = table["label_in_file"] if "label_in_file" in table else [None] * len(table)
    return tuple(
        Roi(name, tissue_class, masks[name], None if pd.isna(label) else label)
        for name, tissue_class, label in zip(table["roi"], table["tissue_class"], labels, strict=True)
    )
