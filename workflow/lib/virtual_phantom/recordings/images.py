"""Recordings of images: NIfTI files or folders of one DICOM series each, in HU, all on one grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from ..base.errors import InputError, InputErrors, lines_of
from ..base.geometry import Grid, OrbitGeometry
from ..io.volumes import LARGEST_TILT, Volume
from ..phantom import Roi
from ..phantom.ct import draw, read_hu
from ..phantom.masks import GRID_TOLERANCE_MM
from ..phantom.plausible import BELOW_AIR_HU, has_air
from ..phantom.rois import read_entries
from .document import Document
from .provenance import check_nominal, check_shared, checksums, dicom_facts
from .recording import Provenance, Recording, Repeats
from .scan import check_lengths, missing_for_geometry, scan_geometry

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


def load_images(document: Document) -> ImagesRecording:
    """Read every image once.

    Raises
    ------
    InputErrors
        If any is not what recording.yaml says: a line for each image.
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
            grid, first = image.grid, path
        elif not image.grid.matches(grid, GRID_TOLERANCE_MM):
            lines.append(
                f"{path}: is on another grid ({image.grid}) than {first.name} ({grid}); "
                "resample it, or make a recording of its own"
            )
        elif image.grid.rotated_against(grid) > LARGEST_TILT:
            lines.append(f"{path}: is rotated against {first.name}; resample it onto the same grid")
        if (below := float((image.array < BELOW_AIR_HU).mean())) > MENTIONED_SHARE:
            share = f"{100 * below:.0f} % of the voxels are below {BELOW_AIR_HU:g} HU"
            notes.append(f"{document.relative(path)}: {share}: padding outside the scanned circle")
        if not has_air(image.array):
            notes.append(f"{document.relative(path)}: shows no air (-1000 HU) that its CT numbers could be checked by")
        if path.is_dir():
            facts[path] = dicom_facts(path)
    if lines:
        raise InputErrors(lines)
    for path, own in facts.items():
        first = next(iter(facts))
        check_shared(own, facts[first], path, first)
        check_nominal(own, document.content["nominal"], document.path)
    _rois(document, grid)
    provenance = Provenance(document.content["origin"], checksums(document), next(iter(facts.values()), {}))
    repeats, held_out = Repeats(document.repeats, read_one), Repeats(document.held_out, read_one)
    return ImagesRecording(document, provenance, _geometry(document), tuple(notes), repeats, held_out, grid)


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
