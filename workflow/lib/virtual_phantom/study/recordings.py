"""Files and settings of the recordings of a configuration, of comparisons with them, and of their image quality."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..base.commands import command_line
from ..base.names import label
from ..config.dependencies import shipped
from ..config.outputs import PICTURES, Files
from ..config.plan import Plan
from ..config.public_scans import PublicScans
from ..config.settings import Comparison
from ..image_quality.settings import ImageQualitySettings
from ..io.published import require_reachable
from ..physics.scenes.object_files import object_path
from ..recordings.document import Document
from .acquisitions import Acquisitions


@dataclass(frozen=True)
class Recordings:
    """Recordings of one configuration.

    Attributes
    ----------
    documents : mapping of str to Document
        {name: content of recording.yaml}.
    """

    plan: Plan
    files: Files
    documents: Mapping[str, Document]

    @classmethod
    def read(cls, plan: Plan, files: Files) -> Recordings:
        """Read the documents of all recordings.

        Raises
        ------
        InputError
            For a recording.yaml that is missing or invalid.
        """
        scans = PublicScans(plan)
        documents = {name: scans.document(folder) for name, folder in plan.study.recordings.items()}
        return cls(plan, files, documents)

    def content(self, name: str) -> dict:
        """Return the content of recording.yaml."""
        return self.documents[name].content

    def folder(self, name: str) -> str:
        """Return the folder of a recording."""
        return str(self.documents[name].folder)

    def sources(self, name: str) -> list[str]:
        """Return the files of a recording."""
        return [str(path) for path in self.documents[name].files]

    def kind(self, name: str) -> str:
        """Return the kind of a recording: projections, images or features."""
        return self.content(name)["kind"]

    def summaries(self) -> list[str]:
        """Return the summaries of all recordings."""
        return [self.files("summary", recording=name) for name in self.documents]

    def pictures(self) -> list[str]:
        """Return the preview figures of recordings of projections and images."""
        return [
            self.files("figure_recording", suffix, recording=name)
            for name in self.documents
            if self.kind(name) != "features"
            for suffix in PICTURES
        ]

    def alignments(self) -> list[str]:
        """Return the alignments of recordings of images, as numbers and as figures."""
        of_images = [name for name in self.documents if self.kind(name) == "images"]
        numbers = [self.files("alignment", recording=name) for name in of_images]
        figures = [self.files("figure_alignment", suffix, recording=name) for name in of_images for suffix in PICTURES]
        return numbers + figures

    def sinogram_online(self, disc: str) -> str:
        """Return the address of a sinogram ("solid_disc", "ta" to "td") of the Helsinki Tomography Challenge 2022.

        Raises
        ------
        InputError
            Without a network.
        """
        file = f"htc2022_{disc}_full.mat"
        advice = "download it on a computer with a network and run " + command_line(
            "virtual-phantom-import", "htc2022", file, self.files("sinogram", disc=disc)
        )
        return require_reachable(f"{self.plan.study.downloads.htc2022}/{file}", advice)

    def inputs(self, name: str) -> dict:
        """Return the files of a recording, and for images the ROIs transferred from the phantom."""
        inputs: dict = {"files": self.sources(name)}
        if self.kind(name) == "images":
            inputs |= {
                "rois": self.files("recorded_table", recording=name),
                "masks": self.files("recorded_rois", recording=name),
            }
        return inputs

    def conditions(self, name: str) -> list[str]:
        """Return the columns that distinguish the conditions of a recording."""
        return self.content(name).get("features", {}).get("conditions", [])

    def megabytes(self, name: str) -> int:
        """Return the memory to read a recording, MB: one acquisition, which is compressed on disk, masks and copies."""
        return 1000 + 12 * self._largest(name) // 10**6

    def image_megabytes(self, name: str) -> int:
        """Return the memory for a few copies of an image and its mask, which are compressed on disk, MB."""
        return 40 * self._largest(name) // 10**6

    def _largest(self, name: str) -> int:
        # A file that is made by a job, and may be missing, is a table of features of some megabytes.
        return max((path.stat().st_size for path in self.documents[name].files if path.exists()), default=0)


@dataclass(frozen=True)
class Comparisons:
    """Comparisons of the study with recordings."""

    plan: Plan
    files: Files
    acquisitions: Acquisitions
    recordings: Recordings

    @property
    def settings(self) -> dict[str, Comparison]:
        """{name: settings in the configuration}."""
        return self.plan.study.analyses.comparison

    def repeats(self, name: str) -> int:
        """Return the number of repeats of the compared noise level."""
        return self.plan.repeats([self.settings[name].noise])

    def features(self, name: str) -> str:
        """Return the features of the recording."""
        return self.files("recorded_features", recording=self.settings[name].recording)

    def images(self, name: str) -> list[str]:
        """Return the images of the study."""
        return self.acquisitions.images(self.settings[name].protocol, self.settings[name].noise)

    def title(self, name: str) -> str:
        """Return the title of a comparison: protocol, noise level and recording."""
        settings = self.settings[name]
        conditions = ", ".join(f"{label(key)} {value}" for key, value in settings.where.items())
        recorded = label(settings.recording) + (f" ({conditions})" if conditions else "")
        return f"{label(settings.protocol)}, noise {label(settings.noise)}, against {recorded}"

    def voxel_mm(self, name: str) -> list[float] | None:
        """Return the voxel size of the recording, mm; None if recording.yaml does not give it."""
        return self.recordings.content(self.settings[name].recording)["nominal"].get("voxel_mm")

    def dimensions(self, name: str) -> int:
        """Return the number of dimensions (2 or 3) in which the features of the recording were extracted."""
        return self._recorded(name).get("dimensions", 3)

    def table_dimensions(self, name: str) -> int | None:
        """Return `dimensions` of a table; None for images, whose features are extracted as in the study."""
        is_table = self.recordings.kind(self.settings[name].recording) == "features"
        return self.dimensions(name) if is_table else None

    def stored_offset_hu(self, name: str) -> float:
        """Return the offset of the stored values of the recording's images from HU."""
        return self._recorded(name).get("stored_offset_hu", 0)

    def _recorded(self, name: str) -> dict:
        return self.recordings.content(self.settings[name].recording).get("features", {})

    def noise_target_features(self, noise: str) -> str:
        """Return the features of the recording that a noise level is matched to."""
        return self.files("recorded_features", recording=self.plan.study.noise.levels[noise].meets.recording)


@dataclass(frozen=True)
class Quality:
    """Image quality of the phantoms in recordings."""

    plan: Plan
    files: Files
    recordings: Recordings

    @property
    def settings(self) -> dict[str, ImageQualitySettings]:
        """{name: settings in the configuration}."""
        return self.plan.study.image_quality

    def all(self) -> list[str]:
        """Return the reports of all phantoms."""
        return [self.files("image_quality_report", quality=name) for name in self.settings]

    def folders(self, name: str) -> dict[str, str]:
        """Return the folders of the recordings of a phantom."""
        return {recording: self.recordings.folder(recording) for recording in self.settings[name].recordings}

    def inputs(self, name: str) -> dict[str, list[str]]:
        """Return the files of the recordings and objects of a phantom."""
        settings = self.settings[name]
        objects = [module.object.kind for module in settings.modules.values() if module.object is not None]
        files = [file for recording in settings.recordings for file in self.recordings.sources(recording)]
        return {"files": files, "objects": [shipped(object_path(kind)) for kind in dict.fromkeys(objects)]}

    def megabytes(self, name: str) -> int:
        """Return the memory of a job, MB: all repeats of one recording, which may be compressed on disk, and copies."""
        sizes = [
            sum(path.stat().st_size for path in self.recordings.documents[recording].files if path.exists())
            for recording in self.settings[name].recordings
        ]
        return 1000 + 16 * max(sizes) // 10**6
