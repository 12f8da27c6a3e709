"""Context: the object through which the rules of the workflow read the configured study."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

from ..base.data import RESOURCES, SCHEMAS
from ..base.errors import InputError, InputErrors, printed
from ..config.config import read_study
from ..config.dependencies import shipped
from ..config.outputs import Files, by_path
from ..config.plan import Plan
from ..config.public_scans import PublicScans
from ..config.read_config import doubtful_entries, read_configs
from ..config.settings import Study
from ..io.files import check_unchanged
from ..projectors import choose_engine
from . import analyses
from .acquisitions import Acquisitions
from .benchmark import Benchmark
from .costs.jobs import Sizes, study_jobs
from .costs.limits import minutes
from .costs.rates import read_rates, seconds
from .diagnosis_jobs import Diagnosis
from .pages import Pages
from .phantom_sources import PhantomSources
from .proof import Proof
from .recordings import Comparisons, Quality, Recordings
from .selections import Selections

# Label of the files of each results folder in Snakemake's report.
LABELS = {
    "figures": "figure",
    "tables": "table",
    "diagnosis": "recording",
    "proof": "recording",
    "image_quality": "phantom",
}

P, T = ParamSpec("P"), TypeVar("T")


@dataclass(frozen=True)
class Context:
    """A study for the rules of the workflow. Methods take wildcards by name, as text.

    Attributes
    ----------
    engine : str
        Engine of the projector (projectors.choose_engine).
    rates : mapping
        Measured costs (costs.rates).
    """

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
    quality: Quality
    diagnosis: Diagnosis
    proof: Proof
    benchmark: Benchmark
    pages: Pages

    @property
    def study(self) -> Study:
        """The complete configuration."""
        return self.plan.study

    # Files

    @property
    def results_folder(self) -> str:
        """The folder of all results."""
        return self.files.results

    def schema(self, name: str) -> str:
        """Return the path of a JSON schema of the library as input of a job."""
        return shipped(SCHEMAS / name)

    @property
    def parameters(self) -> dict:
        """Settings of feature extraction: arguments of features.parameters.read_parameters."""
        features = self.study.features
        return {
            "path": features.parameters,
            "section": features.section,
            "stored_offset_hu": features.stored_offset_hu,
        }

    @property
    def parameter_files(self) -> list[str]:
        """The parameter file of pyradiomics as inputs of rules, if the configuration has one."""
        return list(filter(None, [self.study.features.parameters]))

    def reported(self, path: str) -> dict:
        """Return how Snakemake's report shows an output: arguments of `report` for a rule of workflow/rules.

        Parameters
        ----------
        path : str
            Path below results_dir, with wildcards in braces.
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
        """Return the paths of all requested tables."""
        return [self.files(output.name, **known) for output, known in analyses.tables(self.plan)]

    def parquet_tables(self) -> list[str]:
        """Return the paths of all requested tables as Parquet."""
        return [f"{path.removesuffix('.csv')}.parquet" for path in self.tables()]

    def targets(self) -> list[str]:
        """Return the paths of all requested files."""
        figures = [
            self.files(output.name, suffix, **known)
            for output, known in analyses.figures(self.plan)
            for suffix in output.suffixes
        ]
        tables = [path for pair in zip(self.tables(), self.parquet_tables(), strict=True) for path in pair]
        return (
            figures
            + tables
            + self.acquisitions.projections()
            + self.acquisitions.position_table()
            + [self.files("index")]
        )

    # Resources of jobs

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
        """Return the memory of a job in MB: its arrays, Python and its libraries.

        Parameters
        ----------
        volumes, volume_lanes : int, optional
            Number of images, and of noise realizations in each.
        projections, projection_lanes : int, optional
            The same for projections of `geometry`.
        fine : int, optional
            Number of volumes on the fine voxels that are scanned.
        """
        floats = volumes * volume_lanes * self.sizes.voxels + fine * self.sizes.fine
        if geometry is not None:
            floats += projections * projection_lanes * self.sizes.rays(geometry)
        return int(600 + 1.3 * floats * 4 / 1e6)

    def alignment_megabytes(self, recording: str) -> int:
        """Return the memory to align a recording in MB: its images and three levels of the phantom."""
        return self.megabytes(volumes=12) + self.recordings.image_megabytes(recording)

    def minutes(self, stage: str, work: Mapping[str, float]) -> int:
        """Return the time limit of a job in minutes, from its stage and work (costs.jobs.Sizes)."""
        return minutes(self.rates, stage, work)

    def expected_seconds(self, cores: int | None = None) -> dict[str, float | tuple[float, float]]:
        """Return the expected core seconds of all jobs whose rate was measured, by output file.

        Parameters
        ----------
        cores : int, optional
            Available cores, if known.

        Returns
        -------
        dict of str to float or tuple of 2 float
            For diagnoses, the lower and the upper end of the range.
        """
        of_study: dict[str, float | tuple[float, float]] = {
            f"{self.files.results}/{file}": takes
            for job in study_jobs(self.plan, self.engine, len(self.plan.tissue_classes))
            if (takes := seconds(job, self.rates)) is not None
            for file in job.outputs
        }
        # The processes of a diagnosis hold all their cores until the last process ends.
        return of_study | {
            self.files("diagnosis", recording=forecast["name"]): tuple(
                end * forecast["processes"] for end in forecast["seconds"]
            )
            for forecast in self.diagnosis.forecasts(cores)
            if forecast["seconds"] is not None
        }


def read_context(config: Mapping, folder: Path, files: Iterable[str | Path] = (), here: bool = True) -> Context:
    """Return the context of a configuration that Snakemake has merged.

    Parameters
    ----------
    folder : Path
        Folder of the rules, scripts and captions.
    files : iterable of str or Path, optional
        Configuration files. A file that was written with a checksum must be unchanged.
    here : bool, optional
        Check devices and files. False in jobs: the main process has checked them, perhaps on another machine.

    Raises
    ------
    InputErrors
        If the configuration has mistakes, or a file that it names is missing or wrong.
    """
    files = list(map(str, files))
    for path in files:
        check_unchanged(path, "make it again")
    if here:
        from .checks.preflight import problems  # jobs do not need it

        doubtful = [line for path in files for line in doubtful_entries(path)]
        if lines := doubtful + problems(config, keep=True):
            raise InputErrors(lines)
        read_configs(files)  # notes each null that removes nothing
    study = read_study(config)
    plan = Plan(study)
    # Without `here`, do not look for devices: a cluster node of a job may have none.
    engine = choose_engine(study.engine, **study.engine_needs, check=here)
    rates = read_rates(RESOURCES / "rates.yaml")
    outputs = Files(study.results)
    sources = PhantomSources(plan)
    acquisitions = Acquisitions(plan, outputs)
    selections = Selections(plan, outputs, acquisitions)
    recordings = Recordings.read(plan, outputs)
    comparisons = Comparisons(plan, outputs, acquisitions, recordings)
    diagnosis = Diagnosis.read(plan, outputs, recordings, engine, rates)
    proof = Proof.read(plan, outputs)
    pages = Pages(plan, outputs, selections, comparisons, diagnosis, folder / "report", tuple(files))
    _ = pages.exported  # raises InputErrors for wrong entries
    return Context(
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
        quality=Quality(plan, outputs, recordings),
        diagnosis=diagnosis,
        proof=proof,
        benchmark=Benchmark.read(proof),
        pages=pages,
    )


def or_exit(function: Callable[P, T]) -> Callable[P, T]:
    """Wrap a function that Snakemake calls: an InputError ends the program with one line instead of a traceback."""

    @wraps(function)
    def ends(*arguments: P.args, **named: P.kwargs) -> T:
        try:
            return function(*arguments, **named)
        except InputError as error:
            sys.exit(printed(error))

    return ends
