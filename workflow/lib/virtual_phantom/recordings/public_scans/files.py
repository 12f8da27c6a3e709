"""Files of public scans: identified by their DICOM tags, whatever their names, and compared with the list."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pydicom

from ...base.errors import InputError
from .table import MB, PublicScan, Series

SIZE_TOLERANCE_MB = 0.0051  # sizes in the list have two decimals
TAGS = ["SeriesInstanceUID", "SOPInstanceUID"]


@dataclass(frozen=True)
class Instance:
    """One DICOM file with its SeriesInstanceUID and SOPInstanceUID."""

    path: Path
    series: str
    instance: str


def read_instance(path: Path) -> Instance | None:
    """Read the identifiers of a file; None if it is not DICOM.

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
    except Exception as error:  # of many types; their messages may quote the header
        raise InputError(
            f"{path}: cannot be read as DICOM ({type(error).__name__}); replace it by a complete copy"
        ) from None


def instances(folder: str | Path) -> Iterator[Instance]:
    """Yield the DICOM files in a folder and below, in the order of their names; hidden files are skipped."""
    for path in sorted(Path(folder).rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if not hidden and path.is_file() and (found := read_instance(path)) is not None:
            yield found


def regions_file(folder: str | Path) -> Path:
    """Return the file of regions in a checked scan's folder."""
    return next((Path(folder) / "seg").iterdir())


def check_series(found: Iterable[Instance], series: Series, where: str, advice: str, sizes: bool = True) -> None:
    """Check that files are one complete series of the list.

    Parameters
    ----------
    advice : str
        What to do about missing or additional files.
    sizes : bool, optional
        Whether to compare sizes with the list. Files from other sources may have been rewritten.

    Raises
    ------
    InputError
        For a file of another series, a repeated slice, another number of files, and another size.
    """
    found = list(found)
    for file in found:
        if file.series != series.uid:
            raise InputError(f"{file.path}: belongs to series {file.series}, not to {series.uid}; {advice}")
    first: dict[str, Path] = {}
    for file in found:
        if (other := first.setdefault(file.instance, file.path)) != file.path:
            raise InputError(f"{file.path}: is the same slice as {other}; remove one of them")
    if len(found) != series.files:
        raise InputError(
            f"{where}: {len(found)} of {series.files} files of its {series.modality} are present; {advice}"
        )
    megabytes = sum(file.path.stat().st_size for file in found) / MB
    if sizes and abs(megabytes - series.megabytes) > SIZE_TOLERANCE_MB:
        raise InputError(
            f"{where}: the files of its {series.modality} have {megabytes:.2f} MB, but the list says "
            f"{series.megabytes:.2f} MB; {advice}"
        )


def find_scans(folder: str | Path, scans: Iterable[PublicScan]) -> dict[str, dict[str, list[Path]]]:
    """Find the files of scans in a folder of any layout, such as from NBIA's or IDC's downloader.

    Returns
    -------
    dict
        {name of the scan: {modality: files}}.

    Raises
    ------
    InputError
        If the folder does not exist, or a scan is missing or incomplete.
    """
    folder, scans = Path(folder), list(scans)
    if not folder.is_dir():
        raise InputError(
            f"downloads.scans: {folder}: no such folder; set the folder with the scans, or null to download"
        )
    by_series: dict[str, list[Instance]] = defaultdict(list)
    for file in instances(folder):
        by_series[file.series].append(file)
    missing = [scan for scan in scans if any(series.uid not in by_series for series in scan.series)]
    if missing:
        first = missing[0]
        kind = next(series.modality for series in first.series if series.uid not in by_series)
        raise InputError(
            f"downloads.scans: {folder}: {len(missing)} of {len(scans)} scans are missing (first: {first.name}, "
            f"{first.description}, without {kind}); set downloads.scans: null to download them, or select fewer under "
            "public_scans"
        )
    advice = f"copy that series to {folder} again, or set downloads.scans: null to download all scans"
    for scan in scans:
        for series in scan.series:
            check_series(by_series[series.uid], series, f"{folder}: scan {scan.name}", advice, sizes=False)
    return {
        scan.name: {series.modality: [file.path for file in by_series[series.uid]] for series in scan.series}
        for scan in scans
    }
