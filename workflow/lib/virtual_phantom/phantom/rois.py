"""ROI entries of the configuration, and the processing of regions to ROIs: margin, parts and separation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.names import same_but_for_case
from ..base.settings import RoiEntry, to_mapping
from ..io.schema import schema_of, validate

FIT_VOXELS = 20_000  # sample size for the cluster centers


def read_roi_entries(
    entries: Sequence[Mapping | RoiEntry], default_file: str | None, source: str = "phantom: ct"
) -> tuple[RoiEntry, ...]:
    """Check and convert entries of phantom.ct.rois, or entries with the same keys of a document.

    Parameters
    ----------
    default_file : str or None
        File for entries that name no file.
    source : str, optional
        Start of messages.

    Raises
    ------
    InputError
        If entries are invalid by the schema, names (also of parts) are equal or differ only in case, or an entry has
        no file.
    """
    entries = [to_mapping(entry) for entry in entries]
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
    """Return the voxels whose centers are farther than a margin from every voxel center outside the region.

    The border of the scan is not a surface: organs that continue beyond it are not shortened there.
    """
    if margin_mm == 0 or mask.all() or not mask.any():
        return mask
    # The bounding box with a margin of one voxel is sufficient.
    box = tuple(slice(max(s.start - 1, 0), s.stop + 1) for s in find_objects(mask.astype(np.uint8))[0])
    shrunk = np.zeros_like(mask)
    shrunk[box] = distance_transform_edt(mask[box], sampling=grid.spacing) > margin_mm
    return shrunk


def cut(mask: np.ndarray, parts: int, grid: Grid) -> list[np.ndarray]:
    """Cut a region into compact parts by k-means of voxel positions, in a reproducible way.

    Parts are ordered from right to left of the patient (decreasing x of their centers). They may touch: see `separate`.
    """
    if parts == 1:
        return [mask]
    index = np.argwhere(mask)
    if len(index) < parts:
        return [mask] + [np.zeros_like(mask)] * (parts - 1)  # empty parts are reported as ROIs without voxels
    positions = index * np.array(grid.spacing)
    from sklearn.cluster import KMeans  # takes a second to import

    clusters = KMeans(parts, n_init=4, random_state=0).fit(positions[:: max(1, len(positions) // FIT_VOXELS)])
    nearest = clusters.predict(positions)
    pieces = []
    for cluster in np.argsort(-clusters.cluster_centers_[:, 2], kind="stable"):
        piece = np.zeros_like(mask)
        piece[tuple(index[nearest == cluster].T)] = True
        pieces.append(piece)
    return pieces


def separate(masks: list[np.ndarray]) -> list[np.ndarray]:
    """Remove from each mask, bool [z, y, x], the voxels that touch another mask at a face, edge or corner."""
    grown = [binary_dilation(mask, np.ones((3, 3, 3), bool)) for mask in masks]
    return [
        mask & ~np.logical_or.reduce([g for j, g in enumerate(grown) if j != i] or [np.zeros_like(mask)])
        for i, mask in enumerate(masks)
    ]
