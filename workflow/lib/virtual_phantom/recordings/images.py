"""Recordings of images: NIfTI files or folders of one DICOM series each, in HU, all on one grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ..base.errors import InputError, InputErrors, lines_of
from ..base.geometry import Grid, OrbitGeometry
from ..io.volumes import LARGEST_TILT, Volume
from ..phantom import Roi
from ..phantom.ct import draw_entry, read_hu
from ..phantom.dicom_series import find_series
from ..phantom.plausibility import BELOW_AIR_HU, has_air
from ..phantom.regions import GRID_TOLERANCE_MM
from ..phantom.rois import read_roi_entries
from .document import Document
from .provenance import check_nominal, check_shared, checksums, series_facts
from .recording import Provenance, Recording, Repeats
from .scan import SIZE, check_lengths, missing_for_geometry, scan_geometry

LEAST_REPORTED_PADDING = 0.01  # share of voxels below air (padding) from which it is reported


@dataclass(frozen=True)
class ImagesRecording(Recording):
    """Repeated images (HU, float32) on one grid."""

    repeats: Repeats[Volume]
    held_out: Repeats[Volume]
    grid: Grid

    def rois(self) -> tuple[Roi, ...]:
        """Return the ROIs of recording.yaml on the recording's grid; empty if it names none.

        Raises
        ------
        InputError
            If a file or label is missing, or a file is on another grid. Also if an ROI is empty on the grid, or loses
            too much of its volume to its margin or to the border of the grid.
        """
        return _rois(self.document, self.grid)


def load_images(document: Document) -> ImagesRecording:
    """Read and check every image once.

    Raises
    ------
    InputErrors
        One line per image that does not match recording.yaml.
    """
    notes: list[str] = []
    lines: list[str] = []
    grid, facts = None, {}
    read_one = partial(read_hu, not_checked=tuple(document.content.get("not_checked", ())))
    for path in (*document.repeats, *document.held_out):
        try:
            image = read_one(path)
        except InputError as error:
            lines += lines_of(error)
            continue
        if grid is None:
            grid, first_image = image.grid, path
        elif mismatch := grid_mismatch(image.grid, grid, path, first_image.name):
            lines.append(mismatch)
        if (below := float((image.array < BELOW_AIR_HU).mean())) > LEAST_REPORTED_PADDING:
            share = f"{100 * below:.0f} % of the voxels are below {BELOW_AIR_HU:g} HU"
            notes.append(f"{document.relative(path)}: {share}: padding outside the scan circle")
        if not has_air(image.array):
            notes.append(f"{document.relative(path)}: contains no air (-1000 HU), so its CT numbers cannot be checked")
        if path.is_dir():
            facts[path] = series_facts(find_series(path))
    if lines:
        raise InputErrors(lines)
    for path, of_series in facts.items():
        first_dicom = next(iter(facts))
        check_shared(of_series, facts[first_dicom], path, first_dicom)
        check_nominal(of_series, document.content["nominal"], document.path)
    _rois(document, grid)  # checks the ROIs now; ImagesRecording.rois draws them again when needed
    provenance = Provenance(document.content["origin"], checksums(document), next(iter(facts.values()), {}))
    repeats, held_out = Repeats(document.repeats, read_one), Repeats(document.held_out, read_one)
    return ImagesRecording(document, provenance, _geometry(document), tuple(notes), repeats, held_out, grid)


def grid_mismatch(grid: Grid, first: Grid, name: str | Path, first_name: str) -> str | None:
    """Return a message if the grid of an image is not the grid of the first image."""
    if not grid.matches(first, GRID_TOLERANCE_MM):
        return (
            f"{name}: is on another grid ({grid}) than {first_name} ({first}); resample it, or make a separate "
            "recording of it"
        )
    if grid.displacement_by_rotation(first) > LARGEST_TILT:
        return f"{name}: is rotated relative to {first_name}; resample it to the same grid"
    return None


def _geometry(document: Document) -> OrbitGeometry | None:
    """Return the geometry if the scan section is complete and can be simulated; check the lengths in any case."""
    scan = document.content.get("scan", {})
    not_checked = document.content.get("not_checked", ())
    if not missing_for_geometry(scan) and scan.get("detector", "flat") == "flat":
        return scan_geometry(scan, str(document.path), not_checked)
    check_lengths(scan, str(document.path), SIZE not in not_checked)
    return None


def _rois(document: Document, grid: Grid) -> tuple[Roi, ...]:
    if "rois" not in document.content:
        return ()
    entries = read_roi_entries(document.content["rois"], document.content.get("labels"), str(document.path))
    rois, open_files = [], {}
    for entry in entries:
        located = replace(entry, file=str(document.folder / entry.file))
        for name, mask in zip(entry.names, draw_entry(located, grid, open_files), strict=True):
            if not mask.any():
                raise InputError(f"{document.path}: rois: {name} is empty; use fewer parts")
            rois.append(Roi(name, entry.tissue_class, mask, entry.label))
    return tuple(rois)
