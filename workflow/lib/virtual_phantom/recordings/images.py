"""Recordings of images: NIfTI files or folders of one DICOM series each, in HU, all on one grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid, OrbitGeometry
from ..io.volumes import Volume, length_unit
from ..phantom import Roi
from ..phantom.ct import draw, read_hu
from ..phantom.masks import GRID_TOLERANCE_MM
from ..phantom.rois import read_entries
from .document import Document
from .provenance import check_nominal, check_shared, checksums, dicom_facts
from .recording import Provenance, Recording, Repeats
from .scan import check_lengths, missing_for_geometry, scan_geometry

WIDTH_MM = (40.0, 1500.0)  # in-plane: from a small phantom to the bore of a scanner
LARGEST_VOXEL_MM = 20.0  # of any side: more are metres or another unit
# Soft tissue and water stored as HU + 1000 or HU + 1024 lie here; of HU, little does: dense bone, PTFE.
OFFSET_TISSUE = (900.0, 1300.0)
MOST_DENSE = 0.1  # share of voxels there; more are stored values, not HU
BELOW_AIR_HU = -1100.0  # lower than the noise of air goes in numbers: padding outside the scanned circle
MENTIONED_SHARE = 0.01  # of voxels that is worth a remark


@dataclass(frozen=True)
class ImagesRecording(Recording):
    """Repeated images (HU, float32) on one grid."""

    repeats: Repeats[Volume]
    held_out: Repeats[Volume]
    grid: Grid

    def rois(self) -> tuple[Roi, ...]:
        """The ROIs that recording.yaml names, on the recording's grid.

        Returns
        -------
        tuple of Roi
            Empty if it names none.

        Raises
        ------
        InputError
            For a file or label that is not there, a file on another grid, and ROIs empty or lost.
        """
        return _rois(self.document, self.grid)


def load(document: Document) -> ImagesRecording:
    """Read every image once.

    Returns
    -------
    ImagesRecording

    Raises
    ------
    InputError
        If any is not what recording.yaml says.
    """
    notes: list[str] = []
    grid, facts = None, {}
    for path in (*document.repeats, *document.held_out):
        image = read(path)
        if grid is None:
            grid = image.grid
        elif not image.grid.matches(grid, GRID_TOLERANCE_MM):
            raise InputError(
                f"{path}: is on another grid ({image.grid}) than {document.repeats[0].name} ({grid}); "
                "resample it, or make a recording of its own"
            )
        if (below := float((image.array < BELOW_AIR_HU).mean())) > MENTIONED_SHARE:
            share = f"{100 * below:.0f} % of the voxels are below {BELOW_AIR_HU:g} HU"
            notes.append(f"{document.relative(path)}: {share}: padding outside the scanned circle")
        if path.is_dir():
            facts[path] = dicom_facts(path)
    for path, own in facts.items():
        first = next(iter(facts))
        check_shared(own, facts[first], path, first)
        check_nominal(own, document.content["nominal"], document.path)
    _rois(document, grid)
    provenance = Provenance(document.content["origin"], checksums(document), next(iter(facts.values()), {}))
    repeats, held_out = Repeats(document.repeats, read), Repeats(document.held_out, read)
    return ImagesRecording(document, provenance, _geometry(document), tuple(notes), repeats, held_out, grid)


def read(path: Path) -> Volume:
    """Read one image in HU.

    Returns
    -------
    Volume
        float32.

    Raises
    ------
    InputError
        If it cannot be read or is tilted (volumes.read_nifti, dicom_series.read_series), if its values are not HU or
        not finite, or if its size cannot be in mm.
    """
    image = read_hu(path)
    _check_size(path, image.grid)
    low, high = OFFSET_TISSUE
    dense = np.count_nonzero((image.array > low) & (image.array < high)) / image.array.size
    if dense > MOST_DENSE:
        raise InputError(
            f"{path}: {100 * dense:.0f} % of the voxels are between {low:g} and {high:g}: 1000 or 1024 was added to "
            "HU; subtract it first"
        )
    return image


def _check_size(path: Path, grid: Grid) -> None:
    if not path.is_dir() and (unit := length_unit(path)) not in ("mm", "unknown"):
        raise InputError(f"{path}: its header gives lengths in {unit}; write it in mm")
    for extent in grid.extent_mm[1:]:
        if not WIDTH_MM[0] <= extent <= WIDTH_MM[1]:
            raise InputError(
                f"{path}: is {extent:.3g} mm wide, where {WIDTH_MM[0]:g} to {WIDTH_MM[1]:g} mm are expected; "
                "are its lengths in mm, not in cm?"
            )
    if max(grid.spacing) > LARGEST_VOXEL_MM:
        raise InputError(f"{path}: has voxels of {max(grid.spacing):g} mm; are its lengths in mm?")


def _geometry(document: Document) -> OrbitGeometry | None:
    """The geometry if the scan section is complete and simulable; what stands in an incomplete one is still checked."""
    scan = document.content.get("scan", {})
    if not missing_for_geometry(scan) and scan.get("detector", "flat") == "flat":
        return scan_geometry(scan, str(document.path))
    check_lengths(scan, str(document.path))
    return None


def _rois(document: Document, grid: Grid) -> tuple[Roi, ...]:
    if "rois" not in document.content:
        return ()
    entries = read_entries(document.content["rois"], document.content.get("labels"), str(document.path))
    rois, open_files = [], {}
    for entry in entries:
        located = replace(entry, file=str(document.folder / entry.file))
        for name, mask in zip(entry.names, draw(located, grid, open_files), strict=True):
            if not mask.any():
                raise InputError(f"{document.path}: ROI {name} is empty; give fewer parts")
            rois.append(Roi(name, entry.tissue_class, mask, entry.label))
    return tuple(rois)
