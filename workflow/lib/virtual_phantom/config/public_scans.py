"""Public scans of the printed phantom that a study takes: which, where they lie, and what is still to be brought."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..base.errors import InputError
from ..io.published import resources_folder
from ..recordings.document import Document, planned_document, read_document
from ..recordings.public_scans.features import EXTRACTED, FLAT, recording_content
from ..recordings.public_scans.table import MB, SOURCE, PublicScan, select_scans, small_subset
from .dependencies import resource
from .outputs import Files
from .plan import Plan

COMPARED = "public_scans.compared"  # in place of a recording's folder
NAMES = {COMPARED + way: f"compared_features{way}" for way in EXTRACTED}  # such places, and what is made for them
IN_RESOURCES = "printed_phantom"  # folder of all scans, which studies share


def made_folders(config: Mapping) -> dict[str, str]:
    """{name in place of a recording's folder: the folder that a rule makes}."""
    made = Files(config["results_dir"].rstrip("/"))
    return {name: str(Path(made(output)).parent) for name, output in NAMES.items()}


@dataclass(frozen=True)
class PublicScans:
    """Of one study."""

    plan: Plan

    @property
    def table(self) -> str:
        """The list of all public scans."""
        return resource("public_scans.csv")

    @cached_property
    def scans(self) -> tuple[PublicScan, ...]:
        """All that the study takes.

        Raises
        ------
        InputError
            For a selection that the list cannot meet.
        """
        return tuple(dict.fromkeys((*self.scanned, *self.compared)))

    @cached_property
    def scanned(self) -> tuple[PublicScan, ...]:
        """Those whose mean is the phantom."""
        return self._chosen("phantom")

    @cached_property
    def compared(self) -> tuple[PublicScan, ...]:
        """Those that the simulation is held against."""
        scans = self._chosen("compared")
        return small_subset(scans) if self.plan.config["subset"] == "small" else scans

    def _chosen(self, use: str) -> tuple[PublicScan, ...]:
        selection = self.plan.config["public_scans"].get(use)
        return () if selection is None else select_scans(selection, f"public_scans.{use}")

    def check(self) -> None:
        """Check what the configuration asks for.

        Raises
        ------
        InputError
            For what the list has not, and for an acquisition that would be held against itself.
        """
        unsaid = [scan for scan in self.scanned if scan.slice_mm is None]
        if unsaid and self.plan.config["public_scans"]["own_blur"] == "removed":
            raise InputError(
                f"config: public_scans.phantom has scan {unsaid[0].name}, whose slice thickness the list does not say, "
                "so that its own blur is not known; set public_scans.own_blur: kept, or take ct_phantom4radiomics"
            )
        own = {(scan.collection, scan.acquisition) for scan in self.scanned}
        if twice := [scan for scan in self.compared if (scan.collection, scan.acquisition) in own]:
            raise InputError(
                f"config: public_scans.phantom and public_scans.compared both have acquisition {twice[0].acquisition} "
                f"of {twice[0].collection}: a scan would be held against itself; take it out of one of them"
            )

    @property
    def regions(self) -> list:
        """Segments of each scan that are taken, by name or number."""
        return self.plan.config["public_scans"]["regions"]

    @property
    def slice_mm(self) -> float | None:
        """Thickness of the slices of those whose mean is the phantom; None if there are none."""
        return self.scanned[0].slice_mm if self.scanned else None

    @property
    def rois(self) -> list[dict]:
        """ROIs that regions of the scans are; their labels count the regions from 1. None of a CT of one's own."""
        ct = self.plan.config["phantom"].get("ct", {})
        return ct["rois"] if "rois" in ct and (self.scanned or "image" not in ct) else []

    def document(self, folder: str) -> Document:
        """What recording.yaml in a folder says, which may be that of the scans that are compared.

        Raises
        ------
        InputError
            As recordings.document.read_document does, and if no scans are compared.
        """
        made = made_folders(self.plan.config)
        if folder not in made.values():
            return read_document(folder)
        if not self.compared:
            raise InputError(f"config: recordings names {COMPARED}, which is not there; say which scans to compare")
        if not self.rois:
            raise InputError(
                f"config: recordings names {COMPARED}, and phantom.ct.rois does not say which segment is which ROI; "
                "give --configfile config/printed_phantom.yaml first, which does"
            )
        return planned_document(
            folder, recording_content(self.compared, FLAT if folder == made[COMPARED + FLAT] else "")
        )

    # Where they lie

    @property
    def place(self) -> str:
        """Folder of a scan, whose name stays a wildcard."""
        return f"{resources_folder()}/{IN_RESOURCES}/{{scan}}"

    def folders(self, scans: Iterable[PublicScan]) -> list[str]:
        """Folders of these scans."""
        return [self.place.format(scan=scan.name) for scan in scans]

    @cached_property
    def absent(self) -> tuple[PublicScan, ...]:
        """Those that are not here yet: a rule brings them."""
        return tuple(scan for scan in self.scans if not Path(self.place.format(scan=scan.name), SOURCE).exists())

    @property
    def own(self) -> str | None:
        """A folder of somebody's own that has them."""
        return self.plan.config["downloads"]["scans"]

    def absent_folders(self) -> list[str]:
        """Those of what is not here yet."""
        return self.folders(self.absent)

    def fetched(self) -> list[str]:
        """What `snakemake fetch` brings.

        Raises
        ------
        InputError
            If the configuration takes no public scans, or keeps none.
        """
        if not self.kept:
            raise InputError(
                "config: keep_scans is false, so that scans are brought when something is made of them, and deleted "
                "then; run the study itself, or set keep_scans: true"
            )
        if not self.scans:
            raise InputError(
                "config: public_scans is empty, so that there is nothing to fetch; give --configfile "
                "config/printed_phantom.yaml"
            )
        return self.folders(self.scans)

    @property
    def kept(self) -> bool:
        """Whether scans stay once everything is made of them."""
        return self.plan.config["keep_scans"]

    @cached_property
    def wanted(self) -> tuple[PublicScan, ...]:
        """Those of what is absent that will be brought: of scans that are not kept, what is not yet made of."""
        if self.kept or self.own:
            return self.absent
        made = Files(self.plan.config["results_dir"].rstrip("/"))
        mean_is_there = Path(made("mean_scan")).exists()
        used = set() if mean_is_there else set(self.scanned)
        used |= {scan for scan in self.compared if not Path(made("scan_features", scan=scan.name)).exists()}
        return tuple(scan for scan in self.absent if scan in used)

    # What is made of them

    def feature_tables(self, output: str) -> list[str]:
        """Of every scan that is compared, its features.

        Parameters
        ----------
        output : {"scan_features", "scan_features_2d"}
        """
        made = Files(self.plan.config["results_dir"].rstrip("/"))
        return [made(output, scan=scan.name) for scan in self.compared]

    def recordings(self) -> list[str]:
        """The tables of all scans that are compared.

        Raises
        ------
        InputError
            If none are, or nothing says which of their segments is which ROI.
        """
        folders = made_folders(self.plan.config)
        for folder in folders.values():
            self.document(folder)
        made = Files(self.plan.config["results_dir"].rstrip("/"))
        return [made(name) for name in NAMES.values()]

    # What is said of them

    def listed(self, name: str) -> str:
        """The series of one scan, for a rehearsal."""
        scan = self.one(name)
        series = " and ".join(
            f"{one.modality} {one.uid} ({one.files} file{'s'[: one.files > 1]}, {one.megabytes:.0f} MB)"
            for one in scan.series
        )
        return f"Scan {scan.name}, {' '.join(scan.description.split())}: {series}"

    def announced(self) -> str | None:
        """How much is to be brought, before anything is; None if nothing is."""
        if not self.wanted:
            return None
        how = f"linked from {self.own}" if self.own else "fetched"
        lines = [f"{self._amount(self.wanted)} to be {how} to {resources_folder()}/{IN_RESOURCES}"]
        if not self.kept and not self.own:
            lines[0] += "; each is deleted once everything is made of it"
        elif len(self.absent) < len(self.scans):
            lines[0] += f"; {len(self.scans) - len(self.absent)} of {len(self.scans)} scans are there"
        groups: dict[tuple[str, str], list[PublicScan]] = {}
        for scan in self.wanted:
            groups.setdefault((scan.collection, scan.group), []).append(scan)
        lines += [f"  {collection}, {group}: {self._amount(of)}" for (collection, group), of in sorted(groups.items())]
        return "\n".join(lines)

    @staticmethod
    def _amount(scans: Iterable[PublicScan]) -> str:
        scans = list(scans)
        size = sum(scan.megabytes for scan in scans) * MB / 1e9
        files = sum(scan.files for scan in scans)
        return f"{len(scans)} CT and {len(scans)} SEG series, {files} files, {size:.1f} GB"

    def one(self, name: str) -> PublicScan:
        """A scan by its name."""
        return next(scan for scan in self.scans if scan.name == name)
