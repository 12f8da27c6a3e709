"""What the phantom is made from: a layout, an object of shapes, or a CT and its regions, which may not be here yet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..config.dependencies import resource, shipped
from ..config.outputs import Files
from ..config.plan import Plan
from ..io.files import files_of
from ..io.published import PublishedFile, check_listed, named_by, reachable, read_published, resources_folder
from ..physics.scenes.object_files import object_path


@dataclass(frozen=True)
class PhantomSources:
    """Files that a study's phantom is made from."""

    plan: Plan

    @property
    def table(self) -> str:
        """The list of the published CT's files."""
        return resource("abdomen_ct.csv")

    @property
    def layout(self) -> list[str]:
        """The layout of the synthetic phantom, if that is taken."""
        settings = self.plan.config["phantom"]
        return [settings["layout"] or resource("phantom.yaml")] if settings["source"] == "synthetic" else []

    def layout_here(self) -> list[str]:
        """The same, if it is there."""
        return present(self.layout)

    @property
    def paths(self) -> list[str]:
        """Paths that the configuration names, files and folders."""
        settings = self.plan.config["phantom"]
        if settings["source"] == "synthetic":
            return self.layout
        if settings["source"] == "object":
            return [shipped(object_path(settings["object"]["kind"]))]
        ct = settings["ct"]
        regions = [ct.get("labels"), *(roi.get("file") for roi in ct["rois"])]
        return [ct["image"], *dict.fromkeys(filter(None, regions))]

    @property
    def made(self) -> list[str]:
        """Those of them that a rule makes of public scans."""
        files = Files(self.plan.config["results_dir"].rstrip("/"))
        return [path for path in self.paths if path in map(files, ("mean_scan", "sharp_scan", "mean_regions"))]

    @cached_property
    def published(self) -> list[PublishedFile]:
        """Those of the published CT's files that they name."""
        return named_by(self.paths, read_published(self.table))

    @cached_property
    def absent(self) -> list[PublishedFile]:
        """Those of them that are not here yet: a rule fetches them."""
        return [file for file in self.published if not Path(file.path).exists()]

    def absent_online(self) -> list[str]:
        """Their addresses.

        Raises
        ------
        InputError
            Without a network.
        """
        folder, here = self.plan.config["downloads"]["abdomen_ct"], f"{resources_folder()}/abdomen_ct"
        advice = (
            f"where there is a network, download the files that {self.table} lists: those of {folder}/example_ct_dicom "
            f"go to {here}/dicom, example_seg_dicom.nii.gz beside it becomes {here}/labels.nii.gz"
        )
        return [reachable(f"{folder}/{file.source}", advice) for file in self.absent]

    def check(self) -> None:
        """Check the published files that are here.

        Raises
        ------
        InputError
            For one that is another one.
        """
        for file in self.published:
            if file not in self.absent:
                check_listed(
                    file.path,
                    file.sha256,
                    self.table,
                    "delete it, and it is fetched again; or name a file of your own under phantom.ct",
                )

    def files(self) -> list[str]:
        """Every file that the phantom is made from; of those that a rule brings or makes, what is not here yet too."""
        fetched = [file.path for file in self.published]
        return [*dict.fromkeys(fetched + self.made + present(self.paths))]


def present(paths: Iterable[str | None]) -> list[str]:
    """The files at these paths, those in folders too. What is missing is left to the script, which says so."""
    return [str(file) for path in paths if path and Path(path).exists() for file in files_of(path)]
