"""Files of public scans: found by their tags, whatever they are called, and held against the list."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pydicom

from ...base.errors import InputError
from .table import MB, PublicScan, Series

SIZE_TOLERANCE_MB = 0.0051  # the list's sizes are rounded to two decimals
TAGS = ["SeriesInstanceUID", "SOPInstanceUID"]


@dataclass(frozen=True)
class Instance:
    """One DICOM file, and what it says that it is.

    Attributes
    ----------
    series, instance : str
        SeriesInstanceUID and SOPInstanceUID.
    """

    path: Path
    series: str
    instance: str


def read_instance(path: Path) -> Instance | None:
    """What a file says that it is.

    Returns
    -------
    Instance or None
        None if it is no DICOM file.

    Raises
    ------
    InputError
        If it begins as DICOM and cannot be read.
    """
    try:
        with path.open("rb") as file:
            if file.read(132)[128:] != b"DICM":  # PS3.10, 7.1
                return None
        header = pydicom.dcmread(path, specific_tags=TAGS, stop_before_pixels=True)
        return Instance(path, str(header.SeriesInstanceUID), str(header.SOPInstanceUID))
    except Exception as error:  # of many types; its words may quote the header
        raise InputError(f"{path}: cannot be read as DICOM ({type(error).__name__}); is the file complete?") from None


def instances(folder: str | Path) -> Iterator[Instance]:
    """The DICOM files in a folder and all folders in it, in the order of their names; hidden ones are passed over."""
    for path in sorted(Path(folder).rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if not hidden and path.is_file() and (found := read_instance(path)) is not None:
            yield found


def regions_file(folder: str | Path) -> Path:
    """The file of regions in the folder of a scan, which has been checked."""
    return next((Path(folder) / "seg").iterdir())


def check_series(found: Iterable[Instance], series: Series, where: str, advice: str, sizes: bool = True) -> None:
    """Check that files are one series of the list, whole.

    Parameters
    ----------
    series : Series
        Which they should be.
    where : str
        What messages begin with.
    advice : str
        What to do about a file too few, or too many.
    sizes : bool, optional
        Also hold their bytes against the list: of what was fetched, not of what others may have written anew.

    Raises
    ------
    InputError
        For a file of another series, one that is there twice, files that are missing or too many, and another size.
    """
    found = list(found)
    for one in found:
        if one.series != series.uid:
            raise InputError(f"{one.path}: is of series {one.series}, not of {series.uid}; {advice}")
    first: dict[str, Path] = {}
    for one in found:
        if (other := first.setdefault(one.instance, one.path)) != one.path:
            raise InputError(f"{one.path}: is the same slice as {other}; keep one of them")
    if len(found) != series.files:
        raise InputError(
            f"{where}: {len(found)} of the {series.files} files of its {series.modality} are here; {advice}"
        )
    megabytes = sum(one.path.stat().st_size for one in found) / MB
    if sizes and abs(megabytes - series.megabytes) > SIZE_TOLERANCE_MB:
        raise InputError(
            f"{where}: the files of its {series.modality} are {megabytes:.2f} MB, and {series.megabytes:.2f} are "
            f"listed; {advice}"
        )


def find_scans(folder: str | Path, scans: Iterable[PublicScan]) -> dict[str, dict[str, list[Path]]]:
    """The files of scans in somebody's own folder, told by their tags, wherever in it they lie.

    Parameters
    ----------
    folder : str or Path
        As NBIA's downloader, IDC's or anything else lays it out.

    Returns
    -------
    dict
        {name of the scan: {modality: files}}.

    Raises
    ------
    InputError
        If the folder is not there, holds none of the scans or not all of them, or one of them not whole.
    """
    folder, scans = Path(folder), list(scans)
    if not folder.is_dir():
        raise InputError(f"downloads.scans: {folder}: no such folder; name the one that holds the scans, or null")
    by_series: dict[str, list[Instance]] = defaultdict(list)
    for one in instances(folder):
        by_series[one.series].append(one)
    missing = [scan for scan in scans if any(series.uid not in by_series for series in scan.series)]
    if missing:
        first = missing[0]
        kind = next(series.modality for series in first.series if series.uid not in by_series)
        raise InputError(
            f"downloads.scans: {folder}: {len(missing)} of {len(scans)} scans are not in it, the first is {first.name} "
            f"({first.description}), whose {kind} is missing; set downloads.scans: null to fetch them, or ask for "
            "fewer under public_scans"
        )
    advice = f"bring that series once more, or set downloads.scans: null and take {folder} no longer"
    for scan in scans:
        for series in scan.series:
            check_series(by_series[series.uid], series, f"{folder}: scan {scan.name}", advice, sizes=False)
    return {
        scan.name: {series.modality: [one.path for one in by_series[series.uid]] for series in scan.series}
        for scan in scans
    }
