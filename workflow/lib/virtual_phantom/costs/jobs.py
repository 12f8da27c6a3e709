"""Every job of a configured study with its work and what it writes, from the configuration alone.

Work and files are counted in units that costs.rates has a rate for:

    job               one job
    fine_voxel        voxels of the finely sampled phantom
    ray               rays of one scan: views x rows x columns
    ray_step          steps of the projector: rays x voxels along the longer side in-plane; SIRT takes them once per
                      term, and once more for its weights
    ray_step_lane     ray steps x realisations
    image             images of single acquisitions
    image_voxel       voxels of all images
    image_voxel_view  voxels of all images x views, as back-projection takes them
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from ..plan import Plan
from . import analyses


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
    sizes = _Sizes(plan, engine, rois)
    jobs = [sizes.phantom(), *sizes.kernels(), *sizes.projections(), *sizes.reconstructions(), *sizes.extractions()]
    for rule, stage, outputs, images in analyses.jobs(plan):
        work = {"job": 1, "image": images, "image_voxel": images * sizes.voxels}
        kind = "figures" if rule.startswith("figure_") else "tables"
        writes = {"features": images * rois} if rule == "merge_features" else {kind: 1}
        jobs.append(Job(rule, stage, outputs, work, writes))
    return jobs


class _Sizes:
    """Jobs of the simulation proper, and the sizes that they share."""

    def __init__(self, plan, engine, rois):
        self.plan, self.engine, self.rois = plan, engine, rois
        grid = plan.config["grid"]
        self.voxels = math.prod(grid["shape"])
        self.fine = self.voxels * grid["oversampling"] ** 3
        self.across = max(grid["shape"][1:])
        self.bundles = plan.bundles()

    def rays(self, geometry):
        settings = self.plan.geometry_settings(geometry)
        return settings["scan"]["rows"] * settings["scan"]["columns"] * settings["projections"]

    def phantom(self):
        files = ("phantom/image.nii.gz", "phantom/fine.nii.gz", "phantom/rois.csv", "phantom/rois")
        return Job("phantom", "phantom", files, {"job": 1, "fine_voxel": self.fine}, {"phantom": self.fine})

    def kernels(self) -> Iterator[Job]:
        for lanes in sorted({1, *map(len, self.bundles)}):
            yield Job("compile_kernels", "compile_kernels", (f"logs/kernels/{lanes}.txt",), {"job": 1})

    def projections(self) -> Iterator[Job]:
        wanted = self.plan.acquisitions()
        fine_across = self.across * self.plan.config["grid"]["oversampling"]
        for geometry in sorted({self.plan.geometry_of(protocol) for protocol, _ in wanted}):
            rays = self.rays(geometry)
            work = {"job": 1, "fine_voxel": self.fine, "ray_step": rays * fine_across}
            stage = "project_physics" if self.plan.geometry_settings(geometry)["physics"] else "project"
            yield Job("project", stage, (f"projections/{geometry}/clean.h5",), work, {"clean projections": rays})
        if not self.plan.config["keep_projections"]:
            return
        for geometry, noise in sorted({(self.plan.geometry_of(protocol), noise) for protocol, noise in wanted}):
            for seed in self.plan.seeds(noise):
                rays = self.rays(geometry)
                file = f"projections/{geometry}/{noise}/seed{seed}.h5"
                yield Job("acquire", "acquire", (file,), {"job": 1, "ray": rays}, {"noisy projections": rays})

    def reconstructions(self) -> Iterator[Job]:
        for bundle, protocols in self.bundles.items():
            for protocol in protocols:
                files = tuple(f"images/{protocol}/{noise}/seed{seed}.nii.gz" for noise, seed in bundle)
                stage, work = self.reconstruction(protocol, len(bundle))
                yield Job("reconstruct", stage, files, work, {"images": len(bundle) * self.voxels})

    def reconstruction(self, protocol, lanes):
        """Stage and work of a job."""
        settings = self.plan.config["protocols"][protocol]
        image_voxels = lanes * self.voxels
        if settings["algorithm"] == "fbp":
            work = {"image_voxel": image_voxels, "image_voxel_view": image_voxels * settings["projections"]}
            return "reconstruct_fbp", {"job": 1, **work}
        sirt = self.plan.config["reconstruction"]["sirt"]
        terms = sirt["iterations"] if sirt["solver"] == "plain" else min(sirt["terms"], sirt["iterations"])
        steps = (terms + 1) * self.rays(self.plan.geometry_of(protocol)) * self.across
        work = {"job": 1, "ray_step": steps, "ray_step_lane": steps * lanes, "image_voxel": image_voxels}
        # Another back-projector, or another machine, has rates of its own.
        if self.engine != "cpu":
            return f"reconstruct_sirt_{self.engine}", work
        return "reconstruct_sirt" + ("" if sirt["backprojector"] == "adjoint" else "_voxel"), work

    def extractions(self) -> Iterator[Job]:
        featured = self.plan.featured()
        for batch, levels in self.plan.seed_batches().items():
            for protocol, noise in featured:
                if noise in levels:
                    files = tuple(f"features/{protocol}/{noise}/seed{seed}.csv" for seed in batch)
                    work = {"job": 1, "image_voxel": len(batch) * self.voxels}
                    yield Job("extract", "extract", files, work, {"features": len(batch) * self.rois})
