"""Base classes of all kinds of recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from ..base.geometry import OrbitGeometry
from .document import Document

Content = TypeVar("Content")


class Repeats(Sequence, Generic[Content]):
    """Sequence of repeated acquisitions. Each is read from its file on access, because all may not fit into memory."""

    def __init__(self, paths: tuple[Path, ...], read: Callable[[Path], Content]):
        self.paths, self._read = paths, read

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Content:
        return self._read(self.paths[index])


@dataclass(frozen=True)
class Provenance:
    """Origin and identity of the data.

    Attributes
    ----------
    origin : dict
        Section `origin` of recording.yaml: citation, license, importer, checksums of the imported files.
    sha256 : dict of str to str or list of str
        Checksums by file (provenance.checksums).
    dicom : dict
        Scan facts from the headers of the first repeat (provenance.series_facts); empty without DICOM files.
    """

    origin: dict
    sha256: dict[str, str | list[str]]
    dicom: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Recording:
    """A checked recording.

    Attributes
    ----------
    document : Document
        Content of recording.yaml.
    geometry : OrbitGeometry or None
        None if the scan section is incomplete.
    notes : tuple of str
        Remarks on the data that need no action.
    """

    document: Document
    provenance: Provenance
    geometry: OrbitGeometry | None
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name in recording.yaml."""
        return self.document.content["name"]

    @property
    def kind(self) -> str:
        """One of "images", "projections" and "features"."""
        return self.document.content["kind"]

    @property
    def phantom(self) -> str | None:
        """Scanned object; None if recording.yaml does not name it."""
        return self.document.content.get("phantom")

    @property
    def isocentre_mm(self) -> tuple[float, float, float] | None:
        """World point of the phantom at the isocenter, mm (x, y, z); None for the center of its volume."""
        point = self.document.content.get("isocentre_mm")
        return tuple(map(float, point)) if point is not None else None

    @property
    def scan(self) -> dict:
        """Scan section as stated, mm, degrees and pixels; empty if there is none."""
        return self.document.content.get("scan", {})

    @property
    def nominal(self) -> dict:
        """Scanner settings as stated in recording.yaml."""
        return self.document.content["nominal"]
