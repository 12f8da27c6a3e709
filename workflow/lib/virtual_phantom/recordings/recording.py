"""What all kinds of recordings have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from ..base.geometry import OrbitGeometry
from .document import Document

Content = TypeVar("Content")


class Repeats(Sequence, Generic[Content]):
    """Repeated acquisitions, each read from its file when it is asked for: they need not fit into memory together."""

    def __init__(self, paths: tuple[Path, ...], read: Callable[[Path], Content]):
        self.paths, self._read = paths, read

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Content:
        return self._read(self.paths[index])


@dataclass(frozen=True)
class Provenance:
    """Where the data come from and what exactly they are.

    Attributes
    ----------
    origin : dict
        As under `origin` of recording.yaml: citation, licence, importer, checksums of what was imported.
    sha256 : dict of str to str or list of str
        Checksums by file (provenance.checksums).
    dicom : dict
        Scan facts of the first repeat's headers (provenance.dicom_facts); empty where there are none.
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
        What recording.yaml says.
    geometry : OrbitGeometry or None
        None where the scan section does not say enough.
    notes : tuple of str
        What a user should know of these data and need not act on.
    """

    document: Document
    provenance: Provenance
    geometry: OrbitGeometry | None
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """As recording.yaml names it."""
        return self.document.content["name"]

    @property
    def kind(self) -> str:
        """One of "images", "projections" and "features"."""
        return self.document.content["kind"]

    @property
    def phantom(self) -> str | None:
        """What was scanned; None if recording.yaml does not say."""
        return self.document.content.get("phantom")

    @property
    def isocentre_mm(self) -> tuple[float, float, float] | None:
        """World point of the phantom at the isocentre, mm (x, y, z); None for the centre of its volume."""
        point = self.document.content.get("isocentre_mm")
        return tuple(map(float, point)) if point is not None else None

    @property
    def scan(self) -> dict:
        """The scan section as given, mm, degrees and pixels; empty where nothing is known."""
        return self.document.content.get("scan", {})

    @property
    def nominal(self) -> dict:
        """What the label on the scanner says."""
        return self.document.content["nominal"]
