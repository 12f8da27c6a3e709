"""All that is wrong with a CT, the regions drawn on it, and the voxels and scans that they are put on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_AIR
from ..features.extraction import MINIMUM_VOXELS
from ..io.volumes import Volume
from ..phantom.ct import check_fit, draw, kept_columns, read_hu, rois_of, trimmed
from ..phantom.masks import open_regions, report_other_frame
from ..phantom.rois import RoiEntry, read_entries
from .coverage import reach_mm
from .preflight_scan import blind_spots, grid_here


def ct_problems(config: Mapping) -> Iterator[str]:
    """What is wrong, a line for each mistake.

    Parameters
    ----------
    config : mapping
        With the schema's defaults, and phantom.ct. Other sections may be missing, and what depends on them is not
        looked at.

    Yields
    ------
    str
    """
    settings = config["phantom"]["ct"]
    entries: tuple[RoiEntry, ...] = ()
    try:
        entries = read_entries(settings["rois"], settings.get("labels"))
    except InputError as error:
        yield str(error)
    try:
        image = read_hu(Path(settings["image"]))
    except InputError as error:
        yield f"phantom.ct.image: {error}"
        for file in dict.fromkeys(entry.file for entry in entries):
            if not Path(file).is_file():
                forms = "NIfTI, NRRD, DICOM SEG or RTSTRUCT"
                yield f"phantom.ct: {file}: no such file; give the path of the ROIs ({forms})"
        return
    for file in dict.fromkeys(entry.file for entry in entries):
        report_other_frame(file, settings["image"])
    image = Volume(np.maximum(image.array, np.float32(HU_AIR)), image.grid)
    kept = np.ones(image.grid.shape[1:], bool)
    if "keep_mm" in settings:
        try:
            kept = kept_columns(settings["keep_mm"], image.grid)
            image = trimmed(image, settings["keep_mm"])
        except InputError as error:
            yield str(error)
    grid = grid_here(config, settings.get("centre_mm", image.grid.centre_mm)) if "grid" in config else None
    if grid is not None:
        try:
            check_fit(image, grid)
        except InputError as error:
            yield str(error)
            # ROIs beyond the grid, rows and columns for it: all of that would be said of the wrong grid.
            grid = None
    masks: dict[str, np.ndarray] = {}
    yield from _regions(entries, image.grid, grid, kept, masks)
    if grid is not None:
        # The phantom is scanned on finer voxels than these, whose centres may lie farther in.
        slack = (math.hypot(*image.grid.spacing[1:]) + math.hypot(*grid.spacing[1:])) / 2
        yield from blind_spots(config, grid, reach_mm(image, grid), masks, slack)


def _regions(
    entries: tuple[RoiEntry, ...], ct: Grid, grid: Grid | None, kept: np.ndarray, masks: dict[str, np.ndarray]
) -> Iterator[str]:
    """What is wrong with regions; those that are right are put into `masks`."""
    opened: dict = {}
    broken: set[str] = set()
    for entry in entries:
        if entry.file in broken:
            continue
        if entry.file not in opened:
            try:
                opened[entry.file] = open_regions(entry.file, ct)
            except InputError as error:
                broken.add(entry.file)
                yield str(error)
                continue
        try:
            if grid is None:
                draw(entry, ct, opened)
                continue
            rois = rois_of(entry, ct, grid, kept, opened)
        except InputError as error:
            text = str(error)
            yield text if text.startswith("ROI") else f"ROI {entry.name}: {text}"
            continue
        for roi in rois:
            masks[roi.name] = roi.mask
            if np.count_nonzero(roi.mask) == 1:
                yield (
                    f"ROI {roi.name}: has one voxel of the grid, and texture needs {MINIMUM_VOXELS}; use a finer grid, "
                    "or a smaller margin_mm, or fewer parts"
                )
