"""The ROI entries of the configuration, and what is done to a region before it becomes ROIs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.words import same_but_for_case
from ..io.schema import schema_of, validate

FIT_VOXELS = 20_000  # enough to place a few cluster centres


@dataclass(frozen=True)
class RoiEntry:
    """One entry under `rois`: where the region is drawn, and how it is made into ROIs.

    Attributes
    ----------
    file : str
        File of the region; by default the common one.
    label : int, str or None
        Which region of the file: a number from 1, or a name.
    margin_mm : float
        Leave out what is nearer than this to the region's surface, mm: a conservative ROI.
    parts : int
        Cut into this many compact ROIs, named name_1, name_2, ...
    fill_gaps : bool
        Interpolate slices of the region that are not drawn, between two that are.
    """

    name: str
    tissue_class: str
    file: str
    label: int | str | None = None
    margin_mm: float = 0.0
    parts: int = 1
    fill_gaps: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Of the ROIs that the entry makes."""
        return (self.name,) if self.parts == 1 else tuple(f"{self.name}_{i}" for i in range(1, self.parts + 1))


def read_entries(entries: list[dict], default_file: str | None, source: str = "phantom: ct") -> tuple[RoiEntry, ...]:
    """The entries of a list as under phantom.ct.rois of the configuration.

    Parameters
    ----------
    default_file : str or None
        File of the regions whose entry names none.
    source : str, optional
        What messages begin with.

    Raises
    ------
    InputError
        For what the configuration's schema refuses, names that are equal or differ only in case (parts have names too),
        and an entry without a file.
    """
    validate({"rois": entries}, {**schema_of("phantom", "ct"), "required": ["rois"]}, source)
    read = [RoiEntry(**{"file": default_file, **entry}) for entry in entries]
    for entry in read:
        if entry.file is None:
            raise InputError(
                f"{source}: rois: {entry.name}: has no file, and there is no common labels file; give one of them"
            )
    names = [name for entry in read for name in entry.names]
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{source}: rois: the name {doubled[0]} is given twice; names must differ")
    if alike := same_but_for_case(names):
        raise InputError(f"{source}: rois: the names {alike[0]} and {alike[1]} differ only in case; rename one of them")
    return tuple(read)


def shrink(mask: np.ndarray, margin_mm: float, grid: Grid) -> np.ndarray:
    """The voxels whose centres are farther than a margin from every voxel centre outside the region.

    The border of the scan is not a surface: an organ that runs on beyond it is not shortened there.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
        The region.
    grid : Grid
        Of the mask.

    Returns
    -------
    ndarray of bool, shape (z, y, x)
    """
    if margin_mm == 0 or mask.all() or not mask.any():
        return mask
    # the region's bounding box and one voxel around it, where there is one, hold all that matters
    box = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in find_objects(mask.astype(np.uint8))[0])
    shrunk = np.zeros_like(mask)
    shrunk[box] = distance_transform_edt(mask[box], sampling=grid.spacing) > margin_mm
    return shrunk


def cut(mask: np.ndarray, parts: int, grid: Grid) -> list[np.ndarray]:
    """Cut a region into compact parts by k-means of its voxels' places; the same parts every time.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
        The region.
    parts : int
        How many.
    grid : Grid
        Of the mask.

    Returns
    -------
    list of ndarray of bool, shape (z, y, x)
        Ordered from the patient's right to left (falling x of their centres). Touching parts are left touching: see
        `separate`.
    """
    if parts == 1:
        return [mask]
    index = np.argwhere(mask)
    if len(index) < parts:
        return [mask] + [np.zeros_like(mask)] * (parts - 1)  # reported as empty ROIs
    places = index * np.array(grid.spacing)
    from sklearn.cluster import KMeans  # a second, for those who cut regions

    clusters = KMeans(parts, n_init=4, random_state=0).fit(places[:: max(1, len(places) // FIT_VOXELS)])
    nearest = clusters.predict(places)
    pieces = []
    for cluster in np.argsort(-clusters.cluster_centers_[:, 2], kind="stable"):
        piece = np.zeros_like(mask)
        piece[tuple(index[nearest == cluster].T)] = True
        pieces.append(piece)
    return pieces


def separate(masks: list[np.ndarray]) -> list[np.ndarray]:
    """Take from each mask, bool [z, y, x], the voxels that touch another, at a face, an edge or a corner."""
    around = np.ones((3, 3, 3), bool)
    grown = [binary_dilation(mask, around) for mask in masks]
    return [
        mask & ~np.logical_or.reduce([g for j, g in enumerate(grown) if j != i] or [np.zeros_like(mask)])
        for i, mask in enumerate(masks)
    ]
