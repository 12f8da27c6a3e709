"""Every job of a configured study with its work and what it writes, from the configuration alone.

Work and files are counted in units that costs.rates has a rate for:

    job               one job
    fine_voxel        voxels of the finely sampled phantom
    ray               rays of one scan: views x rows x columns
    ray_step          steps of the projector: rays x voxels along the longer side in-plane; SIRT takes them once per
                      term, once more for its weights, and for each REGISTER of realisations
    ray_step_lane     ray steps x realisations
    image             images of single acquisitions
    image_voxel       voxels of all images
    image_voxel_view  voxels of all images x views, as back-projection takes them
    comparison        features x ROIs x pairs of groups x repeats, as the interval of the stability takes them
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from ...config.outputs import BY_NAME, Output
from ...config.plan import Plan
from ...features.names import FEATURES
from .. import analyses
from ..acquisitions import GRID

# Realizations that fill a vector register of the projector; fewer cost the same (docs/explanation/performance.md).
REGISTER = 16


@dataclass(frozen=True)
class Job:
    """One job.

    Attributes
    ----------
    rule : str
        Without the numbers by which rules of one kind differ.
    stage : str
        What it is counted under, the name of its rates.
    outputs : tuple of str
        Its files, in results_dir.
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
    """All jobs of a complete configuration's study, what `snakemake` makes without a target.

    Parameters
    ----------
    engine : str
        What projects, as projectors.choose_engine gives it.
    rois : int
        Regions of interest of the phantom.
    """
    sizes = Sizes(plan, engine)
    jobs = [_phantom(sizes), *_rois(sizes), *_kernels(sizes), *_projections(sizes), *_reconstructions(sizes)]
    jobs += _extractions(sizes, rois)
    for job in analyses.jobs(plan):
        output = job.outputs[0]
        files = job.images * rois if output.counted == "features" else 1
        work = sizes.intervals(rois) if job.stage == "trust" else sizes.images(job.images)
        jobs.append(_job(output, job.files, work, files))
    return jobs


def _job(
    output: Output, files: tuple[str, ...], work: dict[str, float], amount: float = 0, stage: str | None = None
) -> Job:
    """A job by one of its outputs, which says its rule and what it is counted under."""
    return Job(output.rule, stage or output.stage, files, work, {output.counted: amount} if output.counted else {})


class Sizes:
    """What jobs of each kind have to do: {unit: amount}, with the stage where that depends on the configuration.

    Parameters
    ----------
    engine : str
        What projects, as projectors.choose_engine gives it.

    Attributes
    ----------
    voxels, fine : int
        How many an image has, and the finely sampled phantom.
    across : int
        Voxels along the longer side in-plane.
    """

    def __init__(self, plan: Plan, engine: str):
        self.plan, self.engine = plan, engine
        grid = plan.config["grid"]
        self.voxels = math.prod(grid["shape"])
        self.fine = self.voxels * grid["oversampling"] ** 3
        self.across = max(grid["shape"][1:])

    def rays(self, geometry: str) -> int:
        """Of one scan of a geometry: views x rows x columns."""
        settings = self.plan.geometry_settings(geometry)
        return settings["scan"]["rows"] * settings["scan"]["columns"] * settings["projections"]

    def phantom(self) -> dict[str, float]:
        """Work of making the phantom."""
        return {"job": 1, "fine_voxel": self.fine}

    def projection(self, geometry: str) -> tuple[str, dict[str, float]]:
        """Stage and work of a geometry's clean projections."""
        stage = "project_physics" if self.plan.has_physics(geometry) else "project"
        steps = self.rays(geometry) * self.across * self.plan.config["grid"]["oversampling"]
        return stage, {"job": 1, "fine_voxel": self.fine, "ray_step": steps}

    def noise(self, geometry: str) -> dict[str, float]:
        """Work of one noisy scan of a geometry."""
        return {"job": 1, "ray": self.rays(geometry)}

    def reconstruction(self, protocol: str, lanes: int) -> tuple[str, dict[str, float]]:
        """Stage and work of a protocol's images of so many realisations."""
        settings = self.plan.config["protocols"][protocol]
        image_voxels = lanes * self.voxels
        if settings["algorithm"] == "fbp":
            work = {"image_voxel": image_voxels, "image_voxel_view": image_voxels * settings["projections"]}
            return "reconstruct_fbp", {"job": 1, **work}
        sirt = self.plan.config["reconstruction"]["sirt"]
        terms = sirt["iterations"] if sirt["solver"] == "plain" else min(sirt["terms"], sirt["iterations"])
        steps = (terms + 1) * self.rays(self.plan.geometry_of(protocol)) * self.across
        work = {
            "job": 1,
            "ray_step": steps * math.ceil(lanes / REGISTER),
            "ray_step_lane": steps * lanes,
            "image_voxel": image_voxels,
        }
        # Another back-projector, or another machine, has rates of its own.
        if self.engine != "cpu":
            return f"reconstruct_sirt_{self.engine}", work
        return "reconstruct_sirt" + ("" if sirt["backprojector"] == "adjoint" else "_voxel"), work

    def intervals(self, rois: int) -> dict[str, float]:
        """Of the stability's intervals, for the 86 features."""
        noise = self.plan.config["analyses"]["stability"]["noise"]
        pairs = math.comb(len(set(self.plan.groups().values())), 2)
        return {"job": 1, "comparison": len(FEATURES) * rois * pairs * self.plan.repeats([noise])}

    def images(self, count: int) -> dict[str, float]:
        """Of a job that reads so many images, or what was made of them."""
        return {"job": 1, "image": count, "image_voxel": count * self.voxels}


def _phantom(sizes: Sizes) -> Job:
    names = ("phantom_image", "phantom_fine", "phantom_table", "phantom_rois")
    files = tuple(path for name in names for path in BY_NAME[name].paths())
    return _job(BY_NAME["phantom_image"], files, sizes.phantom(), sizes.fine)


def _rois(sizes: Sizes) -> Iterator[Job]:
    """On the voxels of scanners, and where the phantom is re-positioned."""
    plan = sizes.plan
    used = {(plan.voxels_of(protocol), seed) for protocol, noise in plan.acquisitions() for seed in plan.still(noise)}
    for label in sorted({label for label, _ in used if label}):
        files = tuple(path for name in ("voxel_table", "voxel_rois") for path in BY_NAME[name].paths(voxels=label))
        yield _job(BY_NAME["voxel_table"], files, sizes.phantom())
    # The scan is looked at by the ROIs on the study's grid.
    moved = {(seed, GRID) for _, seed in plan.moved_scans()}
    moved |= {
        (seed, label)
        for protocol, noise in plan.acquisitions()
        for seed in plan.moved(noise)
        if (label := plan.voxels_of(protocol))
    }
    for seed, label in sorted(moved):
        known = {"seed": seed, "voxels": label}
        files = tuple(path for name in ("moved_table", "moved_rois") for path in BY_NAME[name].paths(**known))
        yield _job(BY_NAME["moved_table"], files, sizes.phantom())


def _kernels(sizes: Sizes) -> Iterator[Job]:
    output = BY_NAME["kernels"]
    for lanes in sorted({1, *map(len, sizes.plan.bundles())}):
        yield _job(output, output.paths(lanes=lanes), {"job": 1})


def _projections(sizes: Sizes) -> Iterator[Job]:
    plan, clean, noisy = sizes.plan, BY_NAME["clean"], BY_NAME["acquisition"]
    wanted = plan.acquisitions()
    for geometry in sorted({plan.geometry_of(protocol) for protocol, noise in wanted if plan.still(noise)}):
        stage, work = sizes.projection(geometry)
        yield _job(clean, clean.paths(geometry=geometry), work, sizes.rays(geometry), stage)
    for geometry, seed in plan.moved_scans():
        stage, work = sizes.projection(geometry)
        moved = BY_NAME["moved_clean"]
        yield _job(moved, moved.paths(geometry=geometry, seed=seed), work, sizes.rays(geometry), stage)
    if not plan.config["keep_projections"]:
        return
    for geometry, noise in sorted({(plan.geometry_of(protocol), noise) for protocol, noise in wanted}):
        for seed in plan.seeds(noise):
            files = noisy.paths(geometry=geometry, noise=noise, seed=seed)
            yield _job(noisy, files, sizes.noise(geometry), sizes.rays(geometry))


def _reconstructions(sizes: Sizes) -> Iterator[Job]:
    image = BY_NAME["image"]
    for bundle, protocols in sizes.plan.bundles().items():
        for protocol in protocols:
            files = tuple(
                path for noise, seed in bundle for path in image.paths(protocol=protocol, noise=noise, seed=seed)
            )
            stage, work = sizes.reconstruction(protocol, len(bundle))
            yield _job(image, files, work, len(bundle) * sizes.voxels, stage)


def _extractions(sizes: Sizes, rois: int) -> Iterator[Job]:
    table, featured = BY_NAME["image_features"], sizes.plan.featured()
    for batch, levels in sizes.plan.seed_batches().items():
        for protocol, noise in featured:
            if noise in levels:
                files = tuple(path for seed in batch for path in table.paths(protocol=protocol, noise=noise, seed=seed))
                yield _job(table, files, sizes.images(len(batch)), len(batch) * rois)
