"""All that the rules of the workflow know of the study that is configured: one object."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

from ..base.data import RESOURCES, SCHEMAS
from ..base.errors import InputError, InputErrors, printed
from ..config.config import complete, flat_detectors
from ..config.dependencies import shipped
from ..config.outputs import BY_NAME, Files, by_path
from ..config.plan import Plan
from ..config.public_scans import PublicScans
from ..config.read_config import doubtful_entries, note_idle_nulls
from ..io.files import check_unchanged
from ..projectors import choose_engine
from . import analyses
from .acquisitions import Acquisitions
from .costs.jobs import Sizes, study_jobs
from .costs.limits import minutes
from .costs.rates import read_rates, seconds
from .diagnosis_jobs import Diagnosis
from .pages import Pages
from .phantom_sources import PhantomSources
from .proof import Proof
from .recordings import Comparisons, Recordings
from .selections import Selections

# What Snakemake's report calls what lies in a folder of the results.
LABELS = {"figures": "figure", "tables": "table", "diagnosis": "recording", "proof": "recording"}

P, T = ParamSpec("P"), TypeVar("T")


@dataclass(frozen=True)
class Context:
    """A study as its rules see it. What takes wildcards takes them by name, as text.

    Attributes
    ----------
    folder : Path
        Where rules, scripts and captions lie.
    engine : str
        What projects (projectors.choose_engine).
    rates : mapping
        Measured costs (costs.rates).
    """

    folder: Path
    plan: Plan
    engine: str
    rates: Mapping
    files: Files
    sizes: Sizes
    phantom: PhantomSources
    scans: PublicScans
    acquisitions: Acquisitions
    selections: Selections
    recordings: Recordings
    comparisons: Comparisons
    diagnosis: Diagnosis
    proof: Proof
    pages: Pages

    @property
    def config(self) -> dict:
        """The complete configuration."""
        return self.plan.config

    # Files

    @property
    def results_folder(self) -> str:
        """The folder of all results."""
        return self.files.results

    def schema(self, name: str) -> str:
        """A JSON schema of the library, as an input."""
        return shipped(SCHEMAS / name)

    @property
    def parameters(self) -> dict:
        """How features are extracted: arguments of features.parameters.read_parameters."""
        features = self.config["features"]
        return {"path": features["parameters"], **{key: features[key] for key in ("section", "stored_offset_hu")}}

    @property
    def parameter_files(self) -> list[str]:
        """The parameter file of pyradiomics as inputs of rules, where there is one."""
        return [path for path in [self.config["features"]["parameters"]] if path]

    def title(self, name: str) -> str | None:
        """What a report calls an output."""
        return BY_NAME[name].title

    def reported(self, path: str) -> dict:
        """Return how Snakemake's report shows an output: arguments of `report` for a rule of workflow/rules.

        Parameters
        ----------
        path : str
            Path below results_dir, with wildcards in braces.

        Returns
        -------
        dict
        """
        output = by_path(path)
        kind = LABELS[output.pattern.partition("/")[0]]
        return {
            "caption": f"../report/{output.caption_file()}",
            "category": output.section,
            "labels": {kind: output.title} if output.title else None,
        }

    # Targets

    def tables(self) -> list[str]:
        """Every table that the configuration asks for."""
        return [self.files(output.name, **known) for output, known in analyses.tables(self.plan)]

    def parquet_tables(self) -> list[str]:
        """The same as Parquet."""
        made = [output.paths(**known)[0].removesuffix(".csv") for output, known in analyses.tables(self.plan)]
        return [self.files("parquet", table=table) for table in made]

    def targets(self) -> list[str]:
        """Everything that the configuration asks for."""
        figures = [
            self.files(output.name, suffix, **known)
            for output, known in analyses.figures(self.plan)
            for suffix in output.suffixes
        ]
        tables = [path for pair in zip(self.tables(), self.parquet_tables(), strict=True) for path in pair]
        return figures + tables + self.acquisitions.kept() + self.acquisitions.placed() + [self.files("index")]

    # What jobs ask of a machine

    def megabytes(
        self,
        *,
        volumes: int = 0,
        volume_lanes: int = 1,
        projections: int = 0,
        projection_lanes: int = 1,
        fine: int = 0,
        geometry: str | None = None,
    ) -> int:
        """Memory of a job from the arrays that it holds, with room for Python and its libraries, MB.

        Parameters
        ----------
        volumes, volume_lanes : int, optional
            Images, and for how many realisations each.
        projections, projection_lanes : int, optional
            The same of projections of `geometry`.
        fine : int, optional
            Volumes on the voxels that are scanned.
        """
        floats = volumes * volume_lanes * self.sizes.voxels + fine * self.sizes.fine
        if geometry is not None:
            floats += projections * projection_lanes * self.sizes.rays(geometry)
        return int(600 + 1.3 * floats * 4 / 1e6)

    def aligned_megabytes(self, recording: str) -> int:
        """Memory to align a recording: its images, compressed on disk, and three levels of the phantom, MB."""
        return self.megabytes(volumes=12) + self.recordings.image_megabytes(recording)

    def minutes(self, stage: str, work: Mapping[str, float]) -> int:
        """How long a job of this stage and work may take (costs.jobs.Sizes)."""
        return minutes(self.rates, stage, work)

    def expected_seconds(self, cores: int | None = None) -> dict[str, float | tuple[float, float]]:
        """{file: seconds that its job takes one core} of the study's jobs and of diagnoses, with a measured rate.

        Of a diagnosis, the lower and the upper end.

        Parameters
        ----------
        cores : int, optional
            That there are, where that is known.

        Returns
        -------
        dict of str to float or tuple of 2 float
        """
        # Regions count for what is written only.
        of_study: dict[str, float | tuple[float, float]] = {
            f"{self.files.results}/{file}": takes
            for job in study_jobs(self.plan, self.engine, rois=0)
            if (takes := seconds(job, self.rates)) is not None
            for file in job.outputs
        }
        # Their processes hold all cores until the last of them is done.
        return of_study | {
            self.files("diagnosis", recording=one["name"]): tuple(end * one["processes"] for end in one["seconds"])
            for one in self.diagnosis.forecasts(cores)
            if one["seconds"] is not None
        }


def read_context(config: Mapping, folder: Path, files: Iterable[str | Path] = (), here: bool = True) -> Context:
    """The context of a configuration as Snakemake has put it together.

    Parameters
    ----------
    folder : Path
        Where rules, scripts and captions lie.
    files : iterable of str or Path, optional
        The configuration's files: one that was written with a checksum must still be the same.
    here : bool, optional
        Whether devices and files are looked for. False: another process has done so, perhaps on another machine.

    Raises
    ------
    InputErrors
        For all that is wrong with the configuration and the files that it names.
    """
    files = list(map(str, files))
    for path in files:
        check_unchanged(path, "make it again")
    if here:
        from .checks.preflight import problems  # which jobs have no need of

        doubtful = [line for path in files for line in doubtful_entries(path)]
        if lines := doubtful + problems(config, keep=True):
            raise InputErrors(lines)
        note_idle_nulls(files)
    plan = Plan(complete(config))
    # On a cluster, jobs that need no device may be where there is none.
    backprojector = plan.config["reconstruction"]["sirt"]["backprojector"]
    engine = choose_engine(plan.config["engine"], backprojector, look=here, flat=flat_detectors(plan.config))
    rates = read_rates(RESOURCES / "rates.yaml")
    outputs = Files(plan.config["results_dir"].rstrip("/"))
    sources = PhantomSources(plan)
    acquisitions = Acquisitions(plan, outputs)
    selections = Selections(plan, outputs, acquisitions)
    recordings = Recordings.read(plan, outputs)
    comparisons = Comparisons(plan, outputs, acquisitions, recordings)
    diagnosis = Diagnosis.read(plan, outputs, recordings, engine, rates)
    proof = Proof.read(plan, outputs)
    pages = Pages(plan, outputs, selections, comparisons, diagnosis, folder / "report", tuple(files))
    _ = pages.exported  # says what is wrong with it
    return Context(
        folder=folder,
        plan=plan,
        engine=engine,
        rates=rates,
        files=outputs,
        sizes=Sizes(plan, engine),
        phantom=sources,
        scans=PublicScans(plan),
        acquisitions=acquisitions,
        selections=selections,
        recordings=recordings,
        comparisons=comparisons,
        diagnosis=diagnosis,
        proof=proof,
        pages=pages,
    )


def or_exit(function: Callable[P, T]) -> Callable[P, T]:
    """The function, which ends the program with one line where it raises InputError.

    For functions that Snakemake calls: of an exception it would print a traceback.
    """

    @wraps(function)
    def ends(*arguments: P.args, **named: P.kwargs) -> T:
        try:
            return function(*arguments, **named)
        except InputError as error:
            sys.exit(printed(error))

    return ends
