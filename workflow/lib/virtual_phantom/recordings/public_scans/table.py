"""The list of the printed phantom's public scans, and which of them a study takes.

A scan is a study of DICOM: one CT series, and one SEG with the regions that were drawn on it. README.md of the
library's resources says where the list comes from.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ...base.data import RESOURCES
from ...base.errors import InputError
from ...io.files import read_text

TABLE = RESOURCES / "public_scans.csv"
MB = 1e6  # bytes; the list's unit: 343 slices of 512 x 512 pixels of 2 bytes are 179.8 of it, and listed as 181.2
SOURCE = "source.json"  # in the folder of a scan that is here whole: whose it is
SMALL = 3  # acquisitions of each group that `subset: small` keeps of those that are compared


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
        Its SeriesInstanceUID.
    folder : str
        Where it lies in the public bucket.
    megabytes : float
        Of all its files, to two decimals.
    """

    modality: str
    uid: str
    folder: str
    files: int
    megabytes: float


@dataclass(frozen=True)
class PublicScan:
    """One scan: its CT and its regions.

    Attributes
    ----------
    name : str
        Its folder's name here; of the tandem study the number of its series.
    collection : str
        One of COLLECTIONS.
    group : str
        Of the tandem study 1 to 8, else the scanner.
    acquisition : int
        Of the tandem study the true number, which all groups share.
    kernel : str
        Empty where the list does not say.
    slice_mm : float or None
        Thickness of its slices; None where the list does not say.
    model : str
        Of the scanner.
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
        """Both."""
        return self.ct, self.seg

    @property
    def files(self) -> int:
        """Of both series."""
        return self.ct.files + self.seg.files

    @property
    def megabytes(self) -> float:
        """Of both series."""
        return self.ct.megabytes + self.seg.megabytes


@cache
def public_scans(table: str | Path = TABLE) -> tuple[PublicScan, ...]:
    """All scans of the list, by collection and name."""
    return tuple(_scan(row) for row in csv.DictReader(read_text(table).splitlines()))


def _scan(row: Mapping[str, str]) -> PublicScan:
    def series(modality: str) -> Series:
        key = modality.lower()
        files = int(row.get(f"{key}_files", 1))  # a SEG is one file
        return Series(modality, row[key], row[f"{key}_folder"], files, float(row[f"{key}_mb"]))

    return PublicScan(
        name=row["scan"],
        collection=row["collection"],
        group=row["group"],
        acquisition=int(row["acquisition"]),
        dose_mgy=float(row["dose_mgy"]),
        reconstruction=row["reconstruction"],
        kernel=row["kernel"],
        slice_mm=float(row["slice_mm"]) if row["slice_mm"] else None,
        model=row["model"],
        description=row["description"],
        study=row["study"],
        ct=series("CT"),
        seg=series("SEG"),
    )


def select_scans(selection: Mapping, where: str, table: str | Path = TABLE) -> tuple[PublicScan, ...]:
    """The scans that a selection of the configuration names.

    Parameters
    ----------
    selection : mapping
        collection, and lists that a scan must be in: groups, acquisitions, dose_mgy, reconstruction. A list that is not
        there, or null, asks for nothing.
    where : str
        Its key in the configuration, for messages.
    table : str or Path, optional
        The list.

    Returns
    -------
    tuple of PublicScan
        In the order of the list. Groups 1 and 2 of the tandem study lack acquisition 1.

    Raises
    ------
    InputError
        For a value that no scan of the collection has, and if no scan has all that is asked for.
    """
    found = [scan for scan in public_scans(table) if scan.collection == selection["collection"]]
    for key, of in (
        ("groups", lambda scan: scan.group),
        ("acquisitions", lambda scan: scan.acquisition),
        ("dose_mgy", lambda scan: scan.dose_mgy),
        ("reconstruction", lambda scan: scan.reconstruction),
    ):
        if (wanted := selection.get(key)) is None:
            continue
        values = {str(value) if key == "groups" else value for value in wanted}
        there = {of(scan) for scan in public_scans(table) if scan.collection == selection["collection"]}
        if unknown := sorted(values - there, key=str):
            raise InputError(
                f"config: {where}.{key} has {unknown[0]}, which {selection['collection']} has not; it has: "
                f"{', '.join(f'{value:g}' if isinstance(value, float) else str(value) for value in sorted(there))}"
            )
        found = [scan for scan in found if of(scan) in values]
    if not found:
        raise InputError(f"config: {where}: no scan of {selection['collection']} is all that; ask for less")
    return tuple(found)


def small_subset(scans: Iterable[PublicScan]) -> tuple[PublicScan, ...]:
    """Of scans the first SMALL acquisitions of each group, dose and reconstruction."""
    kept: dict[tuple, list[PublicScan]] = {}
    for scan in sorted(scans, key=lambda scan: scan.acquisition):
        alike = kept.setdefault((scan.group, scan.dose_mgy, scan.reconstruction), [])
        if len(alike) < SMALL:
            alike.append(scan)
    return tuple(scan for alike in kept.values() for scan in alike)
