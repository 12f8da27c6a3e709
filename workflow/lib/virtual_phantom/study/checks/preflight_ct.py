"""Find all errors of a CT and its regions, and check that grid and scans fit them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from ...base.console import note
from ...base.errors import InputError, lines_of
from ...base.geometry import Grid
from ...base.settings import RoiEntry
from ...base.units import HU_AIR
from ...config.settings import Study
from ...features import MINIMUM_VOXELS
from ...io.volumes import Volume
from ...phantom.ct import check_fit, check_hu, draw_entry, kept_columns, make_rois, read_hu, trimmed
from ...phantom.masks import open_regions, report_other_frame
from ...phantom.plausibility import CHECKS, note_without_air
from ...phantom.rois import read_roi_entries
from .coverage import TISSUE_HU, reach_mm, removed_tissue
from .preflight_scan import blind_spots, world_grid

KEEP_MM = "keep_mm"  # under phantom.ct.not_checked
# Largest fraction of the body that keep_mm may remove. A strip with 2 % of a body of 330 mm is about 7 mm wide and
# changes the photons behind it by 13 % (0.02 per mm).
MOST_CUT = 0.02


def ct_problems(study: Study) -> Iterator[str]:
    """Yield one line for each error.

    Parameters
    ----------
    study : Study
        With phantom.ct. Checks that need other sections are skipped if these are None.
    """
    settings = study.phantom.ct
    entries: tuple[RoiEntry, ...] = ()
    try:
        entries = read_roi_entries(settings.rois, settings.labels)
    except InputError as error:
        yield str(error)
    path, not_checked = Path(settings.image), settings.not_checked or ()
    try:
        image = read_hu(path, CHECKS)
    except InputError as error:
        yield from (f"phantom.ct.image: {line}" for line in lines_of(error))
        for file in dict.fromkeys(entry.file for entry in entries):
            if not Path(file).is_file():
                forms = "NIfTI, NRRD, DICOM SEG or RTSTRUCT"
                yield f"phantom.ct: {file}: no such file; give the path of the ROIs ({forms})"
        return
    for file in dict.fromkeys(entry.file for entry in entries):
        report_other_frame(file, settings.image)
    in_hu = True
    try:
        check_hu(image, path, not_checked)
        note_without_air(image.array, path)
    except InputError as error:
        in_hu = False  # the body cannot be found, so the checks of grid and scans are skipped
        yield from (f"phantom.ct.image: {line}" for line in lines_of(error))
    whole = image = Volume(np.maximum(image.array, np.float32(HU_AIR)), image.grid)
    kept = np.ones(image.grid.shape[1:], bool)
    if settings.keep_mm:
        try:
            kept = kept_columns(settings.keep_mm, image.grid)
            image = trimmed(image, settings.keep_mm)
        except InputError as error:
            yield str(error)
    grid = None
    if study.grid and in_hu:
        grid = world_grid(study, settings.centre_mm or image.grid.centre_mm)
        try:
            check_fit(image, grid)
        except InputError as error:
            yield str(error)
            # Errors of ROIs and detector would refer to the wrong grid.
            grid = None
    masks: dict[str, np.ndarray] = {}
    yield from _regions(entries, image.grid, grid, kept, masks)
    if grid is not None:
        if not kept.all():
            yield from _cut(whole, grid, kept, masks, not_checked)
        # The scanned phantom has finer voxels, whose centers may lie closer to the axis.
        slack = (math.hypot(*image.grid.spacing[1:]) + math.hypot(*grid.spacing[1:])) / 2
        yield from blind_spots(study, grid, reach_mm(image, grid), masks, slack)


def _cut(
    image: Volume, grid: Grid, kept: np.ndarray, masks: Mapping[str, np.ndarray], not_checked: Collection[str]
) -> Iterator[str]:
    """Report how much tissue keep_mm removes: an error if much of the body is lost, otherwise a note."""
    removed = removed_tissue(image, grid, kept)
    if not removed.share:
        return
    near = ""
    if removed.columns.any() and masks:
        distances = {name: removed.distance_mm(grid, mask) for name, mask in masks.items()}
        nearest = min(distances, key=distances.get)
        near = f", {distances[nearest]:.0f} mm from the nearest ROI ({nearest})"
    if removed.body_share > MOST_CUT and KEEP_MM not in not_checked:
        box = ", ".join(f"[{low:.0f}, {high:.0f}]" for low, high in removed.box_mm)
        yield (
            f"phantom.ct.keep_mm: removes {100 * removed.body_share:.2g} % of the body (voxels above "
            f"{TISSUE_HU:g} HU in its filled outline){near}; widen it to [{box}] or delete it (if it is right: "
            f"not_checked: [{KEEP_MM}])"
        )
        return
    note(
        f"phantom.ct.keep_mm: removes {100 * removed.share:.2g} % of the tissue (voxels above {TISSUE_HU:g} HU): "
        f"{100 * removed.detached_share:.2g} % outside the body, such as arms and table, and "
        f"{100 * (removed.share - removed.detached_share):.2g} % of the body{near}"
    )


def _regions(
    entries: tuple[RoiEntry, ...], ct: Grid, grid: Grid | None, kept: np.ndarray, masks: dict[str, np.ndarray]
) -> Iterator[str]:
    """Yield the errors of regions, and add the masks of the other regions to `masks`."""
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
                draw_entry(entry, ct, opened)
                continue
            rois = make_rois(entry, ct, grid, kept, opened)
        except InputError as error:
            text = str(error)
            yield text if text.startswith("ROI") else f"ROI {entry.name}: {text}"
            continue
        for roi in rois:
            masks[roi.name] = roi.mask
            if np.count_nonzero(roi.mask) == 1:
                yield (
                    f"ROI {roi.name}: has one voxel of the grid, and texture needs {MINIMUM_VOXELS}; use a finer grid, "
                    "a smaller margin_mm or fewer parts"
                )
