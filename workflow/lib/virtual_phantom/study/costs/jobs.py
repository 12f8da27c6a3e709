"""Jobs of a configured study with their amounts of work and output, from the configuration alone.

Amounts are counted in units, each with a rate in costs.rates::

    job               one job
    fine_voxel        voxels of the finely sampled phantom
    ray               rays of all scans: views x rows x columns; FBP counts a ray twice, and once more for each filter
    ray_step          steps of the projector: rays x voxels along the longer side in-plane; SIRT needs them once for
                      each term and once for its weights, for every REGISTER of realizations
    ray_step_lane     ray steps x realizations
    image             images of single acquisitions
    image_voxel       voxels of all images
    image_voxel_view  voxels of all images x views, for back-projection
    image_voxel_term  voxels of all images x terms of SIRT, each with several operations on the images
    comparison        features x ROIs x pairs of groups x repeats, for the intervals of the stability analysis
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from ...base.settings import SirtSettings
from ...config.outputs import BY_NAME, Output
from ...config.plan import MOVED, Bundle, Plan
from ...features.names import FEATURES
from .. import analyses
from ..acquisitions import GRID

# HU by which 95 % of the voxels change with a Chebyshev term (sirt.py). It gives 53 terms for a tolerance of 1 HU; a
# phantom inside the grid took 50, and one that crosses its ends 65 (python -m benchmarks run sirt_tolerance).
CHANGE_HU = 1200.0
# Realizations that fill a vector register of the projector; fewer cost the same (docs/explanation/performance.md).
REGISTER = 16
# Images on a scanner's voxels are made in boxes around ROIs, for two kernels together. They take this share of the
# rate: 22 s instead of 64 s with the version of the measured rate (eight images of the default study, Intel Xeon).
BOXES = 0.34
# A single realization has its own kernels: 0.67 s per image instead of 3.2 s for sixteen (same page).
ONE_LANE = 0.2


@dataclass(frozen=True)
class Job:
    """One job.

    Attributes
    ----------
    rule : str
        Name of the rule, without the number that distinguishes rules of one kind.
    stage : str
        Name of its rates.
    outputs : tuple of str
        Output files, relative to results_dir.
    work : dict of str to float
        {unit: amount}.
    writes : dict of str to float
        {kind of file: amount in the unit of its rate}.
    """

    rule: str
    stage: str
    outputs: tuple[str, ...]
    work: dict[str, float]
    writes: dict[str, float] = field(default_factory=dict)


def study_jobs(plan: Plan, engine: str, rois: int) -> list[Job]:
    """Return all jobs that `snakemake` without a target runs, with the engine and the number of ROIs of the study."""
    sizes = Sizes(plan, engine)
    jobs = [_phantom(sizes), *_rois(sizes), *_kernels(sizes), *_projections(sizes), *_reconstructions(sizes)]
    jobs += _extractions(sizes, rois)
    for job in analyses.jobs(plan):
        output = job.outputs[0]
        files = job.images * rois if output.counted == "features" else 1
        work = sizes.intervals(rois) if output.stage == "trust" else sizes.images(job.images)
        jobs.append(_job(output, job.files, work, files))
    return jobs


def _job(
    output: Output, files: tuple[str, ...], work: dict[str, float], amount: float = 0, stage: str | None = None
) -> Job:
    """Return a job, with rule and stage taken from one of its outputs."""
    return Job(output.rule, stage or output.stage, files, work, {output.counted: amount} if output.counted else {})


class Sizes:
    """Amounts of work of each kind of job, {unit: amount}, with the stage if it depends on the configuration.

    Parameters
    ----------
    engine : str
        Projector, see projectors.choose_engine.

    Attributes
    ----------
    voxels, fine : int
        Voxels of an image and of the finely sampled phantom.
    across : int
        Voxels along the longer side in-plane.
    """

    def __init__(self, plan: Plan, engine: str):
        self.plan, self.engine = plan, engine
        grid = plan.study.grid
        self.voxels = math.prod(grid.shape)
        self.fine = self.voxels * grid.oversampling**3
        self.across = max(grid.shape[1:])

    def rays(self, geometry: str) -> int:
        """Return the rays of one scan of a geometry: views x rows x columns."""
        settings = self.plan.geometry_settings(geometry)
        return settings.scan.rows * settings.scan.columns * settings.projections

    def phantom(self) -> dict[str, float]:
        """Return the work of making the phantom."""
        return {"job": 1, "fine_voxel": self.fine}

    def projection(self, geometry: str) -> tuple[str, dict[str, float]]:
        """Return stage and work of the noise-free projections of a geometry."""
        stage = "project_physics" if self.plan.has_physics(geometry) else "project"
        rays = self.rays(geometry) * self.plan.geometry_settings(geometry).scan.samples ** 2
        steps = rays * self.across * self.plan.study.grid.oversampling
        return stage, {"job": 1, "fine_voxel": self.fine, "ray_step": steps}

    def noise(self, geometry: str) -> dict[str, float]:
        """Return the work of one noisy scan of a geometry."""
        return {"job": 1, "ray": self.rays(geometry)}

    def reconstruction(self, protocols: Sequence[str], lanes: int) -> tuple[str, dict[str, float]]:
        """Return stage and work of a job that makes images of protocols for a number of realizations."""
        settings = self.plan.study.protocols[protocols[0]]
        image_voxels, rays = lanes * self.voxels, lanes * self.rays(self.plan.geometry_of(protocols[0]))
        if settings.algorithm == "fbp":  # on a GPU, the rate of the CPU is an upper limit
            kernels = {(one.kernel, one.noise_kernel) for one in map(self.plan.study.protocols.get, protocols)}
            boxes = [BOXES if self.plan.study.protocols[name].voxels else 1.0 for name in protocols]
            back_projected = sum(boxes) * image_voxels * settings.projections
            # Reading and noise of a ray take 3.5 times the time of a filter (8.7 s beside 2.5 s).
            work = {"job": 1, "ray": (3.5 + len(kernels)) * rays, "image_voxel_view": back_projected}
            return "reconstruct_fbp", work
        sirt = self.plan.study.reconstruction.sirt
        updates = sirt_updates(sirt) + 1
        steps = updates * rays / lanes * self.across
        work = {
            "job": 1,
            "ray_step": steps * (math.ceil(lanes / REGISTER) if lanes > 1 else ONE_LANE),
            "ray_step_lane": steps * lanes,
            "image_voxel": image_voxels,
            "image_voxel_term": image_voxels * updates,
        }
        # Another back-projector or engine has its own rates.
        if self.engine != "cpu":
            return f"reconstruct_sirt_{self.engine}", work
        return "reconstruct_sirt" + ("" if sirt.backprojector == "adjoint" else "_voxel"), work

    def intervals(self, rois: int) -> dict[str, float]:
        """Return the work of the intervals of the stability analysis, for the 86 features."""
        pairs = math.comb(len(set(self.plan.groups().values())), 2)
        repeats = self.plan.repeats(self.plan.compared_levels().values())
        return {"job": 1, "comparison": len(FEATURES) * rois * pairs * repeats}

    def images(self, count: int) -> dict[str, float]:
        """Return the work of a job that reads a number of images or data from them."""
        return {"job": 1, "image": count, "image_voxel": count * self.voxels}


def sirt_updates(sirt: SirtSettings) -> int:
    """Return the expected number of applications of projector and back-projector that SIRT needs."""
    if sirt.solver == "plain":
        return sirt.iterations
    most = min(sirt.terms, sirt.iterations)
    # The coefficients after term j sum to about erfc((j + 1/2) / sqrt(K)).
    enough = (
        j for j in range(2, most) if CHANGE_HU * math.erfc((j + 0.5) / math.sqrt(sirt.iterations)) <= sirt.tolerance_hu
    )
    return next(enough, most)


def _phantom(sizes: Sizes) -> Job:
    names = ("phantom_image", "phantom_fine", "phantom_table", "phantom_rois")
    files = tuple(path for name in names for path in BY_NAME[name].paths())
    return _job(BY_NAME["phantom_image"], files, sizes.phantom(), sizes.fine)


def _rois(sizes: Sizes) -> Iterator[Job]:
    """Yield the jobs of ROIs on scanner voxels and of ROIs of a re-positioned phantom."""
    plan = sizes.plan
    used = {
        (plan.voxels_of(protocol), seed)
        for protocol, noise in plan.acquisitions()
        for seed in plan.nominal_seeds(noise)
    }
    for label in sorted({label for label, _ in used if label}):
        files = tuple(path for name in ("voxel_table", "voxel_rois") for path in BY_NAME[name].paths(voxels=label))
        yield _job(BY_NAME["voxel_table"], files, sizes.phantom())
    # The coverage of the scan is checked with the ROIs on the study's grid.
    moved = {(seed, GRID) for _, position, seed in plan.own_scans() if position == MOVED}
    moved |= {
        (seed, label)
        for protocol, noise in plan.acquisitions()
        for seed in plan.repositioned_seeds(noise)
        if (label := plan.voxels_of(protocol))
    }
    for seed, label in sorted(moved):
        known = {"seed": seed, "voxels": label}
        files = tuple(path for name in ("moved_table", "moved_rois") for path in BY_NAME[name].paths(**known))
        yield _job(BY_NAME["moved_table"], files, sizes.phantom())


def _kernels(sizes: Sizes) -> Iterator[Job]:
    output = BY_NAME["kernels"]
    plan = sizes.plan
    used = {
        (plan.study.protocols[protocols[0]].algorithm, lanes)
        for bundle, protocols in plan.jobs()
        for lanes in plan.lanes(protocols[0], bundle)
    }
    for step, lanes in sorted({("project", 1), *used}):
        yield _job(output, output.paths(step=step, lanes=lanes), {"job": 1})


def _projections(sizes: Sizes) -> Iterator[Job]:
    plan, clean, noisy = sizes.plan, BY_NAME["clean"], BY_NAME["acquisition"]
    wanted = plan.acquisitions()
    for geometry in plan.shared_scans():
        stage, work = sizes.projection(geometry)
        yield _job(clean, clean.paths(geometry=geometry), work, sizes.rays(geometry), stage)
    for geometry, position, seed in plan.own_scans():
        stage, work = sizes.projection(geometry)
        own = BY_NAME["own_clean"]
        files = own.paths(geometry=geometry, position=position, seed=seed)
        yield _job(own, files, work, sizes.rays(geometry), stage)
    if not plan.study.keep_projections:
        return
    for geometry, noise in sorted({(plan.geometry_of(protocol), noise) for protocol, noise in wanted}):
        for seed in plan.seeds(noise):
            files = noisy.paths(geometry=geometry, noise=noise, seed=seed)
            yield _job(noisy, files, sizes.noise(geometry), sizes.rays(geometry))


def _reconstructions(sizes: Sizes) -> Iterator[Job]:
    image = BY_NAME["image"]
    for bundle, protocols in sizes.plan.jobs():
        files = _of_images(image, bundle, protocols)
        stage, work = sizes.reconstruction(protocols, len(bundle))
        yield _job(image, files, work, len(files) * sizes.voxels, stage)


def _extractions(sizes: Sizes, rois: int) -> Iterator[Job]:
    table = BY_NAME["image_features"]
    for bundle, protocols in sizes.plan.jobs(sizes.plan.acquisitions_with_features()):
        files = _of_images(table, bundle, protocols)
        yield _job(table, files, sizes.images(len(files)), len(files) * rois)


def _of_images(output: Output, bundle: Bundle, protocols: Sequence[str]) -> tuple[str, ...]:
    """Return the paths of an output that has one file per image, in the order of the rules."""
    return tuple(
        path
        for protocol in protocols
        for noise, seed in bundle
        for path in output.paths(protocol=protocol, noise=noise, seed=seed)
    )
