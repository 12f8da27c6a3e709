"""Content of the pages of a study, and images for the DICOM export."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..base.commands import snakemake
from ..base.errors import InputError
from ..base.names import label
from ..base.settings import to_mapping
from ..config.dependencies import shipped
from ..config.outputs import BY_NAME, OUTPUTS, Files, Output, filled
from ..config.plan import Plan
from ..config.read_config import DEFAULT, PAPER_GROUPS
from . import analyses
from .changes import extraction_pairs, setting_pairs
from .diagnosis_jobs import Diagnosis
from .recordings import Comparisons
from .selections import Selections

REPORT_TITLE, VIEWER_TITLE = "All figures and sortable tables in one file", "Viewer of slices"


@dataclass(frozen=True)
class Pages:
    """Pages of one study.

    Attributes
    ----------
    captions : Path
        Folder of the caption templates, which Snakemake's report also uses.
    configured_by : tuple of str
        Configuration files, including the default one.
    """

    plan: Plan
    files: Files
    selections: Selections
    comparisons: Comparisons
    diagnosis: Diagnosis
    captions: Path
    configured_by: tuple[str, ...] = ()

    @cached_property
    def _figures(self) -> list[tuple[Output, dict[str, str]]]:
        return analyses.figures(self.plan)

    def pictures(self) -> list[str]:
        """Return the figures in the order of the report."""
        return [self.files(output.name, ".png", **known) for output, known in self._figures]

    def caption_files(self) -> list[str]:
        """Return the caption files of the figures."""
        return [shipped(self.captions / output.caption_file(**known)) for output, known in self._figures]

    def figures(self) -> list[dict]:
        """Return section, title and caption parameters of the figures."""
        return [self._figure_entry(output, known) for output, known in self._figures]

    def _figure_entry(self, output: Output, known: dict[str, str]) -> dict:
        title = filled(output.title or "", **known)
        if "comparison" in known:
            title = self.comparisons.title(known["comparison"])
        params = {
            "threshold": self.plan.study.statistics.threshold,
            "measured_acquisitions": self.selections.measured_acquisitions,
            "recording": self.selections.own_reference,
            "measured": self.selections.measured_noise,
            "title": title,
        }
        return {"section": output.section, "title": title, "params": params, "wildcards": known}

    @cached_property
    def _tables(self) -> list[tuple[Output, dict[str, str]]]:
        """Tables with a title in the order of OUTPUTS, then the others."""
        tables = analyses.tables(self.plan)
        return sorted(tables, key=lambda table: OUTPUTS.index(table[0]) if table[0].title else len(OUTPUTS))

    def tables(self) -> list[str]:
        """Return the tables in the order of the report."""
        return [self.files(output.name, **known) for output, known in self._tables]

    def table_titles(self) -> list[str]:
        """Return the titles of the tables."""
        return [
            filled(output.title, **{kind: label(name) for kind, name in known.items()})
            if output.title
            else label(Path(filled(output.pattern, **known)).stem)
            for output, known in self._tables
        ]

    def impossible(self) -> list[str]:
        """Return a sentence for each requested analysis that the ROIs or protocols do not allow."""
        return analyses.impossible(self.plan)

    def diagnoses(self) -> dict[str, float]:
        """Return {page: time of change, s since the epoch} for the existing diagnoses.

        They are no inputs of the study's report, which must not start a diagnosis.
        """
        paths = map(Path, self.diagnosis.reports())
        return {str(path): path.stat().st_mtime for path in paths if path.exists()}

    def links(self) -> dict[str, str]:
        """Return {title: page} for the pages that the report links to."""
        return {VIEWER_TITLE: BY_NAME["viewer"].pattern} if self.selections.optimal_images() else {}

    @property
    def other_pages(self) -> dict[str, str]:
        """{title: page} for other pages of the study. They are no inputs of the index page."""
        return {REPORT_TITLE: BY_NAME["report"].pattern, VIEWER_TITLE: BY_NAME["viewer"].pattern}

    def existing_pages(self) -> dict[str, str]:
        """Return {title: page} for the existing pages of `other_pages`."""
        return {title: page for title, page in self.other_pages.items() if Path(self.files.results, page).exists()}

    def setting_pairs(self) -> list[dict]:
        """Return the pairs of settings in the table of robust features."""
        pairs = setting_pairs(self.plan)
        if pairs and self.plan.compares_extraction:
            pairs = (*pairs, *extraction_pairs(self.plan))
        return to_mapping(pairs)

    def commands(self) -> dict[str, str]:
        """Return {purpose: command} for the next steps, the most useful first."""
        # Jobs get absolute paths. A page shows relative paths, which are easier to type.
        given = [path for path in self.configured_by if not path.endswith(DEFAULT)]
        if given and given[-1].endswith(PAPER_GROUPS):  # Snakemake adds the base last
            given.pop()
        relative = [Path(os.path.relpath(path)) for path in given]
        overlays = [str(Path(path).absolute() if ".." in path.parts else path) for path in relative]
        settings = ["--cores", "2", *(["--configfile", *overlays] if overlays else [])]

        def command(*targets: str, settings: Sequence[str] = settings) -> str:
            return snakemake(*targets, *settings, snakefile=self.captions.parent / "Snakefile")

        commands = {}
        trial = self.plan.study.trial
        if isinstance(trial, str):
            commands["A study of normal size, for real results"] = trial
        elif trial:
            commands["The default study, for real results"] = command(settings=["--cores", "2"])
        if self.plan.study.recordings:
            commands["Summary of your recordings"] = command("recordings")
        if self.diagnosis.reports():
            commands["Diagnosis: physics that the simulation lacks"] = command("diagnosis")
        if self.plan.study.image_quality:
            commands["Image quality of your phantoms"] = command("image_quality")
        commands[REPORT_TITLE] = command("report_page")
        if self.selections.optimal_images():
            commands[VIEWER_TITLE] = command("viewer")
        commands["Expected cost of the configured study"] = command("plan")
        commands["This study again, after a change or for missing files"] = command()
        return commands

    def viewer_images(self) -> dict[str, list[str]]:
        """Return {algorithm: images} of the viewer.

        Raises
        ------
        InputError
            Without analyses.optimal.
        """
        if not (images := self.selections.optimal_images()):
            raise InputError("config: the viewer needs analyses.optimal; add it with sirt, fbp and noise")
        return images

    def viewer_subtitle(self) -> str:
        """Return the subtitle of the viewer."""
        return f"Noise level {self.plan.study.analyses.optimal.noise}. Single scans have seed 00."

    @cached_property
    def exported(self) -> list[tuple[str, str, str]]:
        """(protocol, noise level, seed) of the exported images, by default of the images in the figure of scans.

        Raises
        ------
        InputError
            For an image that the study does not make.
        """
        acquired = {
            f"{protocol}/{noise}/seed{seed}": (protocol, noise, seed)
            for protocol, noise in self.plan.acquisitions()
            for seed in self.plan.seeds(noise)
        }
        wanted = self.plan.study.dicom.images
        for image in wanted:
            if image not in acquired:
                raise InputError(
                    f"config: dicom.images names {image}, which the study does not make; name an image of the folder "
                    f"images, such as {min(acquired, default='none')}"
                )
        optimal = self.plan.study.analyses.optimal
        if not wanted and optimal:
            return [(optimal.fbp, optimal.noise, "00"), (optimal.sirt, optimal.noise, "00")]
        return [acquired[image] for image in wanted]

    def exported_files(self) -> list[str]:
        """Return the files of the DICOM export.

        Raises
        ------
        InputError
            Without images to export.
        """
        if not self.exported:
            raise InputError("config: nothing to export; name images of the folder images under dicom.images")
        return [
            self.files(name, protocol=protocol, noise=noise, seed=seed)
            for protocol, noise, seed in self.exported
            for name in ("series", "segments")
        ]

    def series(self, protocol: str, noise: str, seed: str) -> dict:
        """Return names and acquisition settings of an exported series."""
        settings, scan = self.plan.study.protocols[protocol], self.plan.scan_of(protocol)
        return {
            "protocol": protocol,
            "label": f"{protocol} {noise} seed {seed} (simulated)",
            "description": f"{settings.algorithm.upper()} of {settings.projections} projections, "
            f"noise level {noise}, seed {seed}.",
            "source_to_isocentre_mm": scan.source_to_isocentre_mm,
            "source_to_detector_mm": scan.source_to_detector_mm,
        }
