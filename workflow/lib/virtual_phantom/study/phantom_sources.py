"""Input files of the phantom: a layout, an object of shapes, or a CT and its regions, which may still be fetched."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..config.dependencies import resource, shipped
from ..config.outputs import Files
from ..config.plan import Plan
from ..io.files import files_of
from ..io.published import PublishedFile, check_listed, named_by, read_published, require_reachable, resources_folder
from ..physics.scenes.object_files import object_path


@dataclass(frozen=True)
class PhantomSources:
    """Input files of a study's phantom."""

    plan: Plan

    @property
    def table(self) -> str:
        """Path of the list of the published CT's files."""
        return resource("abdomen_ct.csv")

    @property
    def layout(self) -> list[str]:
        """Layout of the synthetic phantom; empty for another source."""
        phantom = self.plan.study.phantom
        return [phantom.layout or resource("phantom.yaml")] if phantom.source == "synthetic" else []

    def layout_here(self) -> list[str]:
        """Return `layout` if the file exists."""
        return present(self.layout)

    @property
    def paths(self) -> list[str]:
        """Files and folders that the configuration names."""
        phantom = self.plan.study.phantom
        if phantom.source == "synthetic":
            return self.layout
        if phantom.source == "object":
            return [shipped(object_path(phantom.object.kind))]
        regions = [phantom.ct.labels, *(roi.file for roi in phantom.ct.rois)]
        return [phantom.ct.image, *dict.fromkeys(filter(None, regions))]

    @property
    def made(self) -> list[str]:
        """Paths of `paths` that a rule makes from public scans."""
        files = Files(self.plan.study.results)
        return [path for path in self.paths if path in map(files, ("mean_scan", "sharp_scan", "mean_regions"))]

    @cached_property
    def published(self) -> list[PublishedFile]:
        """Files of the published CT that `paths` contains."""
        return named_by(self.paths, read_published(self.table))

    @cached_property
    def absent(self) -> list[PublishedFile]:
        """Files of `published` that are still to be fetched."""
        return [file for file in self.published if not Path(file.path).exists()]

    def absent_online(self) -> list[str]:
        """Return the addresses of the `absent` files.

        Raises
        ------
        InputError
            Without a network.
        """
        folder, here = self.plan.study.downloads.abdomen_ct, f"{resources_folder()}/abdomen_ct"
        advice = (
            f"on a computer with a network, download the files listed in {self.table}: put the files "
            f"of {folder}/example_ct_dicom into {here}/dicom, and save example_seg_dicom.nii.gz from there as "
            f"{here}/labels.nii.gz"
        )
        return [require_reachable(f"{folder}/{file.source}", advice) for file in self.absent]

    def check(self) -> None:
        """Check the published files that exist.

        Raises
        ------
        InputError
            For a file with another content.
        """
        for file in self.published:
            if file not in self.absent:
                check_listed(
                    file.path,
                    file.sha256,
                    self.table,
                    "delete it to fetch it again, or name your own file under phantom.ct",
                )

    def files(self) -> list[str]:
        """Return all input files, including those that a rule fetches or makes."""
        fetched = [file.path for file in self.published]
        return [*dict.fromkeys(fetched + self.made + present(self.paths))]


def present(paths: Iterable[str | None]) -> list[str]:
    """Return the existing files at these paths and in these folders. Scripts report missing files."""
    return [str(file) for path in paths if path and Path(path).exists() for file in files_of(path)]
