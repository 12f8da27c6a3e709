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
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from .. import analyses
from ..plan import Plan

# Realisations that a step of the projector takes at once, whether there are as many or not (docs/speed.md).
REGISTER = 16


@dataclass(frozen=True)
class Job:
    """One job.

    rule     its rule, without the numbers by which rules of one kind differ
    stage    what it is counted under, the name of its rates
    outputs  its files, in results_dir
    work     {unit: amount}
    writes   {kind of file: amount in the unit of its rate}
    """

    rule: str
    stage: str
    outputs: tuple[str, ...]
    work: dict[str, float]
    writes: dict[str, float] = field(default_factory=dict)


def study_jobs(plan: Plan, engine: str, rois: int) -> list[Job]:
    """All jobs of a complete configuration's study, what `snakemake` makes without a target.

    engine   what projects, as projectors.choose_engine gives it
    rois     regions of interest of the phantom
    """
    sizes = Sizes(plan, engine)
    jobs = [_phantom(sizes), *_kernels(sizes), *_projections(sizes), *_reconstructions(sizes)]
    jobs += _extractions(sizes, rois)
    for rule, stage, outputs, images in analyses.jobs(plan):
        kind = "figures" if rule.startswith("figure_") else "tables"
        writes = {"features": images * rois} if rule == "merge_features" else {kind: 1}
        jobs.append(Job(rule, stage, outputs, sizes.images(images), writes))
    return jobs


class Sizes:
    """What jobs of each kind have to do: {unit: amount}, with the stage where that depends on the configuration."""

    def __init__(self, plan: Plan, engine: str):
        self.plan, self.engine = plan, engine
        grid = plan.config["grid"]
        self.voxels = math.prod(grid["shape"])
        self.fine = self.voxels * grid["oversampling"] ** 3
        self.across = max(grid["shape"][1:])

    def rays(self, geometry: str) -> int:
        settings = self.plan.geometry_settings(geometry)
        return settings["scan"]["rows"] * settings["scan"]["columns"] * settings["projections"]

    def phantom(self) -> dict[str, float]:
        return {"job": 1, "fine_voxel": self.fine}

    def projection(self, geometry: str) -> tuple[str, dict[str, float]]:
        """Stage and work of a geometry's clean projections."""
        stage = "project_physics" if self.plan.geometry_settings(geometry)["physics"] else "project"
        steps = self.rays(geometry) * self.across * self.plan.config["grid"]["oversampling"]
        return stage, {"job": 1, "fine_voxel": self.fine, "ray_step": steps}

    def noise(self, geometry: str) -> dict[str, float]:
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

    def images(self, count: int) -> dict[str, float]:
        """Of a job that reads so many images, or what was made of them."""
        return {"job": 1, "image": count, "image_voxel": count * self.voxels}


def _phantom(sizes):
    files = ("phantom/image.nii.gz", "phantom/fine.nii.gz", "phantom/rois.csv", "phantom/rois")
    return Job("phantom", "phantom", files, sizes.phantom(), {"phantom": sizes.fine})


def _kernels(sizes) -> Iterator[Job]:
    for lanes in sorted({1, *map(len, sizes.plan.bundles())}):
        yield Job("compile_kernels", "compile_kernels", (f"logs/kernels/{lanes}.txt",), {"job": 1})


def _projections(sizes) -> Iterator[Job]:
    plan = sizes.plan
    wanted = plan.acquisitions()
    for geometry in sorted({plan.geometry_of(protocol) for protocol, _ in wanted}):
        stage, work = sizes.projection(geometry)
        files = (f"projections/{geometry}/clean.h5",)
        yield Job("project", stage, files, work, {"clean projections": sizes.rays(geometry)})
    if not plan.config["keep_projections"]:
        return
    for geometry, noise in sorted({(plan.geometry_of(protocol), noise) for protocol, noise in wanted}):
        for seed in plan.seeds(noise):
            file = f"projections/{geometry}/{noise}/seed{seed}.h5"
            writes = {"noisy projections": sizes.rays(geometry)}
            yield Job("acquire", "acquire", (file,), sizes.noise(geometry), writes)


def _reconstructions(sizes) -> Iterator[Job]:
    for bundle, protocols in sizes.plan.bundles().items():
        for protocol in protocols:
            files = tuple(f"images/{protocol}/{noise}/seed{seed}.nii.gz" for noise, seed in bundle)
            stage, work = sizes.reconstruction(protocol, len(bundle))
            yield Job("reconstruct", stage, files, work, {"images": len(bundle) * sizes.voxels})


def _extractions(sizes, rois) -> Iterator[Job]:
    featured = sizes.plan.featured()
    for batch, levels in sizes.plan.seed_batches().items():
        for protocol, noise in featured:
            if noise in levels:
                files = tuple(f"features/{protocol}/{noise}/seed{seed}.csv" for seed in batch)
                yield Job("extract", "extract", files, sizes.images(len(batch)), {"features": len(batch) * rois})
