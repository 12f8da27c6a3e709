"""Select the public scans of the printed phantom that a study uses, and list the scans that must be downloaded."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..base.errors import InputError
from ..base.names import counted
from ..base.settings import RoiEntry, to_mapping
from ..io.published import resources_folder
from ..recordings.document import Document, planned_document, read_document
from ..recordings.public_scans.features import EXTRACTION_MODES, FLAT, recording_content
from ..recordings.public_scans.table import MB, SOURCE, PublicScan, select_scans, small_subset
from .dependencies import resource
from .outputs import Files
from .plan import Plan
from .settings import ScanSelection

COMPARED = "public_scans.compared"  # value of `recordings` instead of a folder
# {such a value: output that is made for it}
NAMES = {COMPARED + mode: f"compared_features{mode}" for mode in EXTRACTION_MODES}
IN_RESOURCES = "printed_phantom"  # folder of all scans, which studies share


def made_folders(results: str) -> dict[str, str]:
    """Return {value of `recordings` instead of a folder: folder that a rule makes}, in a folder of results."""
    made = Files(results)
    return {name: str(Path(made(output)).parent) for name, output in NAMES.items()}


@dataclass(frozen=True)
class PublicScans:
    """Public scans of one study."""

    plan: Plan

    @property
    def table(self) -> str:
        """Path of the list of all public scans."""
        return resource("public_scans.csv")

    @cached_property
    def scans(self) -> tuple[PublicScan, ...]:
        """All scans that the study uses.

        Raises
        ------
        InputError
            For a selection that matches no scan of the list.
        """
        return tuple(dict.fromkeys((*self.scanned, *self.compared)))

    @cached_property
    def scanned(self) -> tuple[PublicScan, ...]:
        """Scans whose mean image is the phantom of the study."""
        return self._chosen("phantom", self.plan.study.public_scans.phantom)

    @cached_property
    def compared(self) -> tuple[PublicScan, ...]:
        """Scans that the simulation is compared with."""
        scans = self._chosen("compared", self.plan.study.public_scans.compared)
        return small_subset(scans) if self.plan.study.subset == "small" else scans

    def _chosen(self, use: str, selection: ScanSelection | None) -> tuple[PublicScan, ...]:
        return () if selection is None else select_scans(to_mapping(selection), f"public_scans.{use}")

    def check(self) -> None:
        """Check the selected scans.

        Raises
        ------
        InputError
            For a selection that matches no scan, and for an acquisition that would be compared with itself.
        """
        unknown = [scan for scan in self.scanned if scan.slice_mm is None]
        if unknown and self.plan.study.public_scans.own_blur == "removed":
            raise InputError(
                f"config: public_scans.phantom has scan {unknown[0].name} with unknown slice thickness, so the blur of "
                "its scanner is unknown; set public_scans.own_blur: kept or use ct_phantom4radiomics"
            )
        scanned = {(scan.collection, scan.acquisition) for scan in self.scanned}
        if twice := [scan for scan in self.compared if (scan.collection, scan.acquisition) in scanned]:
            raise InputError(
                f"config: public_scans.phantom and public_scans.compared both have acquisition {twice[0].acquisition} "
                f"of {twice[0].collection}: a scan would be compared with itself; remove it from one of them"
            )

    @property
    def slice_mm(self) -> float | None:
        """Slice thickness of the scans whose mean image is the phantom; None without such scans."""
        return self.scanned[0].slice_mm if self.scanned else None

    @property
    def rois(self) -> tuple[RoiEntry, ...]:
        """ROIs from regions of the scans, with labels that count the regions from 1; empty for a user's own CT."""
        ct = self.plan.study.phantom and self.plan.study.phantom.ct
        return ct.rois if ct and ct.rois and (self.scanned or ct.image is None) else ()

    def document(self, folder: str) -> Document:
        """Read recording.yaml in a folder, or return the document of the compared scans for a folder made from these.

        Raises
        ------
        InputError
            See recordings.document.read_document; and if no scans are compared.
        """
        made = made_folders(self.plan.study.results)
        if folder not in made.values():
            return read_document(folder)
        if not self.compared:
            raise InputError(f"config: recordings names {COMPARED}, which is missing; select the scans to compare")
        if not self.rois:
            raise InputError(
                f"config: recordings names {COMPARED}, but phantom.ct.rois does not assign segments to ROIs; "
                "give --configfile config/printed_phantom.yaml first"
            )
        return planned_document(
            folder, recording_content(self.compared, FLAT if folder == made[COMPARED + FLAT] else "")
        )

    # Folders and fetching

    @property
    def scan_folder(self) -> str:
        """Folder of a scan, with its name as a wildcard."""
        return f"{resources_folder()}/{IN_RESOURCES}/{{scan}}"

    def folders(self, scans: Iterable[PublicScan]) -> list[str]:
        """Return the folders of scans."""
        return [self.scan_folder.format(scan=scan.name) for scan in scans]

    @cached_property
    def absent(self) -> tuple[PublicScan, ...]:
        """Scans that are not fetched yet."""
        return tuple(scan for scan in self.scans if not Path(self.scan_folder.format(scan=scan.name), SOURCE).exists())

    def fetched(self) -> list[str]:
        """Return the folders that `snakemake fetch` makes.

        Raises
        ------
        InputError
            If the configuration uses no public scans, or does not keep them.
        """
        if not self.plan.study.keep_scans:
            raise InputError(
                "config: keep_scans is false, so the study fetches each scan when it needs it and then deletes it; run "
                "the study, or set keep_scans: true"
            )
        if not self.scans:
            raise InputError(
                "config: public_scans is empty, so there is nothing to fetch; give --configfile "
                "config/printed_phantom.yaml"
            )
        return self.folders(self.scans)

    @cached_property
    def to_fetch(self) -> tuple[PublicScan, ...]:
        """Absent scans that will be fetched. Scans that are not kept are fetched only if a result needs them."""
        if self.plan.study.keep_scans or self.plan.study.downloads.scans:
            return self.absent
        made = Files(self.plan.study.results)
        used = set() if Path(made("mean_scan")).exists() else set(self.scanned)
        used |= {scan for scan in self.compared if not Path(made("scan_features", scan=scan.name)).exists()}
        return tuple(scan for scan in self.absent if scan in used)

    # Results

    def feature_tables(self, output: str) -> list[str]:
        """Return the feature tables of all compared scans; `output` is "scan_features" or "scan_features_2d"."""
        made = Files(self.plan.study.results)
        return [made(output, scan=scan.name) for scan in self.compared]

    def recordings(self) -> list[str]:
        """Return the tables of all compared scans.

        Raises
        ------
        InputError
            If no scans are compared, or their segments are not assigned to ROIs.
        """
        folders = made_folders(self.plan.study.results)
        for folder in folders.values():
            self.document(folder)
        made = Files(self.plan.study.results)
        return [made(name) for name in NAMES.values()]

    # Texts

    def series_text(self, name: str) -> str:
        """Describe the series of one scan, for a dry run."""
        scan = self.by_name(name)
        texts = " and ".join(
            f"{series.modality} {series.uid} ({counted(series.files, 'file')}, {series.megabytes:.0f} MB)"
            for series in scan.series
        )
        return f"Scan {scan.name}, {' '.join(scan.description.split())}: {texts}"

    def fetch_text(self) -> str | None:
        """Describe the amount of data to download; None if there is none."""
        if not self.to_fetch:
            return None
        local = self.plan.study.downloads.scans
        how = f"linked from {local}" if local else "fetched"
        lines = [f"{self._amount(self.to_fetch)} to be {how} to {resources_folder()}/{IN_RESOURCES}"]
        if not self.plan.study.keep_scans and not local:
            lines[0] += "; each scan is deleted after use"
        elif len(self.absent) < len(self.scans):
            lines[0] += f"; {len(self.scans) - len(self.absent)} of {len(self.scans)} scans already exist"
        groups: dict[tuple[str, str], list[PublicScan]] = {}
        for scan in self.to_fetch:
            groups.setdefault((scan.collection, scan.group), []).append(scan)
        lines += [f"  {collection}, {group}: {self._amount(of)}" for (collection, group), of in sorted(groups.items())]
        return "\n".join(lines)

    @staticmethod
    def _amount(scans: Iterable[PublicScan]) -> str:
        scans = list(scans)
        size = sum(scan.megabytes for scan in scans) * MB / 1e9
        files = sum(scan.files for scan in scans)
        return f"{len(scans)} CT and {len(scans)} SEG series, {files} files, {size:.1f} GB"

    def by_name(self, name: str) -> PublicScan:
        """Return a scan by its name."""
        return next(scan for scan in self.scans if scan.name == name)
