"""The recordings of a configuration, and the study's comparisons with them, as jobs take them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..base.commands import typed
from ..base.words import label
from ..config.outputs import PICTURES, Files
from ..config.plan import Plan
from ..config.public_scans import PublicScans
from ..io.published import reachable
from ..recordings.document import Document
from .acquisitions import Acquisitions


@dataclass(frozen=True)
class Recordings:
    """Of one configuration.

    Attributes
    ----------
    documents : mapping of str to Document
        {name: what its recording.yaml says}.
    """

    plan: Plan
    files: Files
    documents: Mapping[str, Document]

    @classmethod
    def read(cls, plan: Plan, files: Files) -> Recordings:
        """Those of a configuration.

        Raises
        ------
        InputError
            For a recording.yaml that is missing or wrong.
        """
        scans = PublicScans(plan)
        documents = {name: scans.document(folder) for name, folder in plan.config["recordings"].items()}
        return cls(plan, files, documents)

    @property
    def names(self) -> list[str]:
        """All of them."""
        return list(self.documents)

    def content(self, name: str) -> dict:
        """What recording.yaml says."""
        return self.documents[name].content

    def folder(self, name: str) -> str:
        """Where it lies."""
        return str(self.documents[name].folder)

    def sources(self, name: str) -> list[str]:
        """Its own files."""
        return [str(path) for path in self.documents[name].files]

    def kind(self, name: str) -> str:
        """projections, images or features."""
        return self.content(name)["kind"]

    def summaries(self) -> list[str]:
        """What is found of each."""
        return [self.files("summary", recording=name) for name in self.documents]

    def pictures(self) -> list[str]:
        """Of those that there is something to be seen of."""
        return [
            self.files("figure_recording", suffix, recording=name)
            for name in self.documents
            if self.kind(name) != "features"
            for suffix in PICTURES
        ]

    def alignments(self) -> list[str]:
        """Of those of images: where the phantom lies, in numbers and as a figure."""
        of_images = [name for name in self.documents if self.kind(name) == "images"]
        numbers = [self.files("alignment", recording=name) for name in of_images]
        figures = [self.files("figure_alignment", suffix, recording=name) for name in of_images for suffix in PICTURES]
        return numbers + figures

    def sinogram_online(self, disc: str) -> str:
        """The address of a sinogram of the Helsinki Tomography Challenge 2022.

        Parameters
        ----------
        disc : {"solid_disc", "ta", "tb", "tc", "td"}

        Raises
        ------
        InputError
            Without a network.
        """
        file = f"htc2022_{disc}_full.mat"
        advice = "where there is a network, download it there and run " + typed(
            "virtual-phantom-import", "htc2022", file, self.files("sinogram", disc=disc)
        )
        return reachable(f"{self.plan.config['downloads']['htc2022']}/{file}", advice)

    def inputs(self, name: str) -> dict:
        """A recording's files, and for images the ROIs that were carried over to it."""
        inputs: dict = {"files": self.sources(name)}
        if self.kind(name) == "images":
            inputs |= {
                "rois": self.files("recorded_table", recording=name),
                "masks": self.files("recorded_rois", recording=name),
            }
        return inputs

    def conditions(self, name: str) -> list[str]:
        """The columns that tell its conditions apart."""
        return self.content(name).get("features", {}).get("conditions", [])

    def voxel_mm(self, name: str) -> list[float] | None:
        """The size of its voxels, where that is stated."""
        return self.content(name)["nominal"].get("voxel_mm")

    def megabytes(self, name: str) -> int:
        """Memory to read it: an acquisition at a time, compressed on disk, and masks and copies beside it, MB."""
        return 1000 + 12 * self._largest(name) // 10**6

    def image_megabytes(self, name: str) -> int:
        """Memory to hold an image and its mask a few times, compressed on disk, MB."""
        return 40 * self._largest(name) // 10**6

    def _largest(self, name: str) -> int:
        # What a job makes is a table of features, some megabytes.
        return max((path.stat().st_size for path in self.documents[name].files if path.exists()), default=0)


@dataclass(frozen=True)
class Comparisons:
    """The study's comparisons with recordings."""

    plan: Plan
    files: Files
    acquisitions: Acquisitions
    recordings: Recordings

    @property
    def settings(self) -> dict[str, dict]:
        """{name: what the configuration asks}."""
        return self.plan.config["analyses"].get("comparison", {})

    def asked(self, name: str, key: str) -> Any:
        """A key of its settings; None if it is not given."""
        return self.settings[name].get(key)

    def recording(self, name: str) -> str:
        """What it compares with."""
        return self.settings[name]["recording"]

    def repeats(self, name: str) -> int:
        """Of its noise level."""
        return self.plan.repeats([self.settings[name]["noise"]])

    def features(self, name: str) -> str:
        """The recording's features."""
        return self.files("recorded_features", recording=self.recording(name))

    def images(self, name: str) -> list[str]:
        """The study's images."""
        return self.acquisitions.images(self.settings[name]["protocol"], self.settings[name]["noise"])

    def title(self, name: str) -> str:
        """What is compared with what, for the head of a figure."""
        one = self.settings[name]
        conditions = ", ".join(f"{label(key)} {value}" for key, value in one["where"].items())
        recorded = label(one["recording"]) + (f" ({conditions})" if conditions else "")
        return f"{label(one['protocol'])}, noise {label(one['noise'])}, against {recorded}"

    def voxel_mm(self, name: str) -> list[float] | None:
        """The size of the recording's voxels, where that is stated."""
        return self.recordings.voxel_mm(self.recording(name))

    def dimensions(self, name: str) -> int:
        """In which the recording's features were extracted."""
        return self._recorded(name).get("dimensions", 3)

    def stored_offset_hu(self, name: str) -> float:
        """What the images of its features were stored with on top of HU."""
        return self._recorded(name).get("stored_offset_hu", 0)

    def _recorded(self, name: str) -> dict:
        return self.recordings.content(self.recording(name)).get("features", {})

    def met(self, noise: str) -> dict:
        """What a matched noise level is to meet."""
        return self.plan.config["noise"]["levels"][noise]["meets"]

    def met_features(self, noise: str) -> str:
        """The features of the recording that it is to meet."""
        return self.files("recorded_features", recording=self.met(noise)["recording"])
