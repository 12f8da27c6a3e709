"""List of public scans of the printed phantom, and selection of scans for a study.

A scan is a DICOM study with one CT series and one SEG with regions drawn on it. The README.md of the library's
resources states the origin of the list.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

from ...base.data import RESOURCES
from ...base.errors import InputError
from ...io.files import read_text

TABLE = RESOURCES / "public_scans.csv"
MB = 1e6  # bytes per unit of the list: 343 slices of 512 x 512 pixels of 2 bytes are 179.8 MB, listed as 181.2
SOURCE = "source.json"  # in the folder of a complete scan: origin of the data
SMALL = 3  # acquisitions per group that `subset: small` keeps for the comparison


@dataclass(frozen=True)
class Collection:
    """A collection of The Cancer Imaging Archive."""

    title: str
    doi: str
    licence: str


COLLECTIONS = {
    "ct_phantom4radiomics": Collection("CT-Phantom4Radiomics", "10.7937/a1v1-rc66", "CC BY 4.0"),
    "ct4harmonization_multicentric": Collection("CT4Harmonization-Multicentric", "10.7937/m0pb-bh69", "CC BY 4.0"),
}


@dataclass(frozen=True)
class Series:
    """One DICOM series.

    Attributes
    ----------
    modality : {"CT", "SEG"}
    uid : str
        SeriesInstanceUID.
    folder : str
        Folder in the public bucket.
    megabytes : float
        Size of all files, to two decimals.
    """

    modality: str
    uid: str
    folder: str
    files: int
    megabytes: float


@dataclass(frozen=True)
class PublicScan:
    """One scan: CT and regions.

    Attributes
    ----------
    name : str
        Name of its folder; in the tandem study, the number of its series.
    collection : str
        Key of COLLECTIONS.
    group : str
        1 to 8 in the tandem study, otherwise the scanner.
    acquisition : int
        In the tandem study, the number of the physical acquisition, which all groups share.
    kernel : str
        Empty if not listed.
    slice_mm : float or None
        Slice thickness; None if not listed.
    model : str
        Scanner model.
    description, study : str
        SeriesDescription of the CT, and StudyInstanceUID.
    """

    name: str
    collection: str
    group: str
    acquisition: int
    dose_mgy: float
    reconstruction: str
    kernel: str
    slice_mm: float | None
    model: str
    description: str
    study: str
    ct: Series
    seg: Series

    @property
    def series(self) -> tuple[Series, Series]:
        """Both series."""
        return self.ct, self.seg

    @property
    def files(self) -> int:
        """Number of files of both series."""
        return self.ct.files + self.seg.files

    @property
    def megabytes(self) -> float:
        """Size of both series."""
        return self.ct.megabytes + self.seg.megabytes


@cache
def public_scans() -> tuple[PublicScan, ...]:
    """Return all scans of the list, by collection and name."""
    return tuple(_scan(row) for row in csv.DictReader(read_text(TABLE).splitlines()))


def _scan(row: Mapping[str, str]) -> PublicScan:
    def series(modality: str) -> Series:
        key = modality.lower()
        files = int(row.get(f"{key}_files", 1))  # a SEG is one file
        return Series(modality, row[key], row[f"{key}_folder"], files, float(row[f"{key}_mb"]))

    texts = ("collection", "group", "reconstruction", "kernel", "model", "description", "study")
    return PublicScan(
        name=row["scan"],
        **{key: row[key] for key in texts},
        acquisition=int(row["acquisition"]),
        dose_mgy=float(row["dose_mgy"]),
        slice_mm=float(row["slice_mm"]) if row["slice_mm"] else None,
        ct=series("CT"),
        seg=series("SEG"),
    )


def select_scans(selection: Mapping, where: str) -> tuple[PublicScan, ...]:
    """Return the scans that a selection of the configuration names, in the order of the list.

    Groups 1 and 2 of the tandem study have no acquisition 1.

    Parameters
    ----------
    selection : mapping
        collection, and lists of accepted values: groups, acquisitions, dose_mgy, reconstruction. A missing list or null
        accepts all values.
    where : str
        Configuration key, for messages.

    Raises
    ------
    InputError
        For a value that no scan of the collection has, or if no scan meets all conditions.
    """
    collection = selection["collection"]
    scans = found = [scan for scan in public_scans() if scan.collection == collection]
    for key in ("groups", "acquisitions", "dose_mgy", "reconstruction"):
        if (wanted := selection.get(key)) is None:
            continue
        attribute = key.removesuffix("s")
        values = {str(value) if key == "groups" else value for value in wanted}
        present = {getattr(scan, attribute) for scan in scans}
        if unknown := sorted(values - present, key=str):
            raise InputError(
                f"config: {where}.{key} has {unknown[0]}, which {collection} does not have; choose from "
                f"{', '.join(f'{value:g}' if isinstance(value, float) else str(value) for value in sorted(present))}"
            )
        found = [scan for scan in found if getattr(scan, attribute) in values]
    if not found:
        raise InputError(f"config: {where}: no scan of {collection} meets all conditions; remove some")
    return tuple(found)


def small_subset(scans: Iterable[PublicScan]) -> tuple[PublicScan, ...]:
    """Return the first SMALL acquisitions of each group, dose and reconstruction."""
    kept: dict[tuple, list[PublicScan]] = {}
    for scan in sorted(scans, key=lambda scan: scan.acquisition):
        alike = kept.setdefault((scan.group, scan.dose_mgy, scan.reconstruction), [])
        if len(alike) < SMALL:
            alike.append(scan)
    return tuple(scan for alike in kept.values() for scan in alike)
