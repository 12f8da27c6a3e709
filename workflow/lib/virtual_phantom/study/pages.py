"""What the pages of the study show, and which of its images are exported as DICOM."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..base.commands import snakemake
from ..base.errors import InputError
from ..base.words import label
from ..config.dependencies import shipped
from ..config.outputs import BY_NAME, OUTPUTS, Files, Output, filled
from ..config.plan import Plan
from . import analyses
from .diagnosis_jobs import Diagnosis
from .recordings import Comparisons
from .selections import Selections

DEFAULT = "config/config.yaml"  # which a study has without being told
WHOLE, SLICES = "Figures and tables that sort, in one file to send on", "Slices to flip through"  # of pages


@dataclass(frozen=True)
class Pages:
    """Of one study.

    Attributes
    ----------
    captions : Path
        Folder of the captions, templates that Snakemake's report fills in too.
    configured_by : tuple of str
        Files of the configuration, the default one among them.
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
        """Figures, in the report's order."""
        return [self.files(output.name, ".png", **known) for output, known in self._figures]

    def caption_files(self) -> list[str]:
        """What is said below each."""
        return [shipped(self.captions / output.caption_file(**known)) for output, known in self._figures]

    def shown(self) -> list[dict]:
        """Section and title of each, and what its caption names."""
        return [self._shown(output, known) for output, known in self._figures]

    def _shown(self, output: Output, known: dict[str, str]) -> dict:
        title = filled(output.title or "", **known)
        if "comparison" in known:
            title = self.comparisons.title(known["comparison"])
        params = {
            "threshold": self.plan.config["statistics"]["threshold"],
            "with_measured": self.plan.config["measured"]["overlay"],
            "recording": self.selections.own_reference,
            "measured": self.selections.measured_noise,
            "title": title,
        }
        return {"section": output.section, "title": title, "params": params, "wildcards": known}

    @cached_property
    def _tables(self) -> list[tuple[Output, dict[str, str]]]:
        """Those with a title in the order of OUTPUTS, then the others."""
        tables = analyses.tables(self.plan)
        return sorted(tables, key=lambda table: OUTPUTS.index(table[0]) if table[0].title else len(OUTPUTS))

    def tables(self) -> list[str]:
        """Tables, in the report's order."""
        return [self.files(output.name, **known) for output, known in self._tables]

    def table_titles(self) -> list[str]:
        """What each is called."""
        return [
            filled(output.title, **{kind: label(name) for kind, name in known.items()})
            if output.title
            else label(Path(filled(output.pattern, **known)).stem)
            for output, known in self._tables
        ]

    def diagnoses(self) -> dict[str, float]:
        """Diagnoses that have been made. They are no inputs of the study's report, which starts none.

        Returns
        -------
        dict of str to float
            {report: when it was made, s of the epoch}.
        """
        paths = map(Path, self.diagnosis.reports())
        return {str(path): path.stat().st_mtime for path in paths if path.exists()}

    def links(self) -> dict[str, str]:
        """Pages beside the report, by what they are called."""
        return {SLICES: BY_NAME["viewer"].pattern} if self.selections.optimal_images() else {}

    @property
    def others(self) -> dict[str, str]:
        """Pages that may stand beside the index page, by what they are called. They are no inputs of it either."""
        return {WHOLE: BY_NAME["report"].pattern, SLICES: BY_NAME["viewer"].pattern}

    def beside(self) -> dict[str, str]:
        """Those of them that have been made."""
        return {title: page for title, page in self.others.items() if Path(self.files.results, page).exists()}

    def commands(self) -> dict[str, str]:
        """What may be done next: the command. What gives an answer is first, the study itself, which is done, last."""
        # Jobs are given whole paths, and a page is to say what anybody can type.
        here = [Path(os.path.relpath(path)) for path in self.configured_by if not path.endswith(DEFAULT)]
        overlays = [str(Path(path).absolute() if ".." in path.parts else path) for path in here]
        settings = ["--cores", "2", *(["--configfile", *overlays] if overlays else [])]

        def command(*targets: str, settings: Sequence[str] = settings) -> str:
            return snakemake(*targets, *settings, snakefile=self.captions.parent / "Snakefile")

        found = {}
        trial = self.plan.config["trial"]
        if isinstance(trial, str):
            found["A study that is large enough for an answer"] = trial
        elif trial:
            found["The default study, large enough to mean something"] = command(settings=["--cores", "2"])
        if self.plan.config["recordings"]:
            found["What your recordings hold"] = command("recordings")
        if self.diagnosis.reports():
            found["Which physics is missing between recordings and simulation"] = command("diagnosis")
        found[WHOLE] = command("report_page")
        if self.selections.optimal_images():
            found[SLICES] = command("viewer")
        found["What a larger study would cost"] = command("plan")
        found["This study again, after a change or where something is missing"] = command()
        return found

    def viewed(self) -> dict[str, list[str]]:
        """Images of the viewer.

        Returns
        -------
        dict of str to list of str
            {algorithm: files}.

        Raises
        ------
        InputError
            If there are none.
        """
        if not (images := self.selections.optimal_images()):
            raise InputError(
                "config: the viewer shows the images of analyses.optimal, which is not there; give it sirt, fbp and "
                "noise"
            )
        return images

    def viewer_subtitle(self) -> str:
        """Which images they are."""
        return f"Noise level {self.plan.config['analyses']['optimal']['noise']}. Single scans are of seed 00."

    @cached_property
    def exported(self) -> list[tuple[str, str, str]]:
        """Images that are exported: by default those of the figure of scans.

        Returns
        -------
        list of (str, str, str)
            Protocol, noise level and seed.

        Raises
        ------
        InputError
            For one that is not made.
        """
        acquired = {
            f"{protocol}/{noise}/seed{seed}": (protocol, noise, seed)
            for protocol, noise in self.plan.acquisitions()
            for seed in self.plan.seeds(noise)
        }
        wanted = self.plan.config["dicom"]["images"]
        for image in wanted:
            if image not in acquired:
                raise InputError(
                    f"config: dicom.images names {image}, which no analysis asks for; name an image that is made, as "
                    f"the folder images has them, such as {min(acquired, default='none')}"
                )
        optimal = self.plan.config["analyses"].get("optimal")
        if not wanted and optimal:
            return [(optimal[algorithm], optimal["noise"], "00") for algorithm in ("fbp", "sirt")]
        return [acquired[image] for image in wanted]

    def exported_files(self) -> list[str]:
        """All that is written of them.

        Raises
        ------
        InputError
            If there are none.
        """
        if not self.exported:
            raise InputError("config: nothing to export; name images under dicom.images, as the folder images has them")
        return [
            self.files(name, protocol=protocol, noise=noise, seed=seed)
            for protocol, noise, seed in self.exported
            for name in ("series", "segments")
        ]

    def series(self, protocol: str, noise: str, seed: str) -> dict:
        """What an exported series is called and how it was acquired."""
        settings = self.plan.config["protocols"][protocol]
        scan = self.plan.geometry_settings(self.plan.geometry_of(protocol))["scan"]
        return {
            "protocol": protocol,
            "label": f"{protocol} {noise} seed {seed} (simulated)",
            "description": f"{settings['algorithm'].upper()} of {settings['projections']} projections, "
            f"noise level {noise}, seed {seed}.",
            "source_to_isocentre_mm": scan["source_to_isocentre_mm"],
            "source_to_detector_mm": scan["source_to_detector_mm"],
        }
