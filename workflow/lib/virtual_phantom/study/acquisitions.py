"""The study's acquisitions as jobs share them out: images, noise levels, and what goes together on a cluster."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

from ..config.outputs import Files
from ..config.plan import Plan

GRID = "grid"  # what the study's own voxels are called where others may stand
Bundle = tuple[tuple[str, str], ...]  # (noise level, seed) of every image that one job makes


@dataclass(frozen=True)
class Acquisitions:
    """Of one study."""

    plan: Plan
    files: Files

    @property
    def noise(self) -> dict:
        """What all of them share."""
        noise = self.plan.config["noise"]
        return {"model": noise["model"], "draws": noise["draws"], "study_seed": self.plan.config["seed"]}

    def one(self, noise: str, seed: str) -> dict:
        """What tells those of one geometry apart. The noise level is None where a job finds it."""
        return {"noise": noise, "noise_level": self.plan.config["noise"]["levels"][noise].get("A"), "seed": int(seed)}

    def images(self, protocol: str, noise: str) -> list[str]:
        """The images of all seeds in which the phantom lies in one place."""
        return [self.files("image", protocol=protocol, noise=noise, seed=seed) for seed in self.plan.still(noise)]

    def clean(self, geometry: str, noise: str, seed: str) -> str:
        """The line integrals that a scan's noise is drawn on."""
        if seed in self.plan.moved(noise):
            return self.files("moved_clean", geometry=geometry, seed=seed)
        return self.files("clean", geometry=geometry)

    def pose(self, seed: str) -> dict:
        """Where the phantom lies in a re-positioned repeat: arguments of phantom.repositioning.drawn_pose."""
        config = self.plan.config
        how = {key: config["repeats"][key] for key in ("shift_mm", "turn_deg")}
        return {"study_seed": config["seed"], "seed": int(seed), **how}

    def positions(self) -> list[dict]:
        """Every repeat of every noise level, and whether the phantom is re-positioned before it."""
        levels = self.plan.config["noise"]["levels"]
        return [
            {"noise": noise, "seed": int(seed), "repositioned": seed in self.plan.moved(noise), "pose": self.pose(seed)}
            for noise in levels
            for seed in self.plan.seeds(noise)
        ]

    def placed(self) -> list[str]:
        """The table of places, where the phantom has more than one."""
        return [self.files("positions")] if self.plan.config["repeats"]["repositioned"] else []

    def kept(self) -> list[str]:
        """Projections that the study asks for beside its analyses."""
        if not self.plan.config["keep_projections"]:
            return []
        scanned = [(self.plan.geometry_of(protocol), noise) for protocol, noise in self.plan.acquisitions()]
        return [
            self.files("acquisition", geometry=geometry, noise=noise, seed=seed)
            for geometry, noise in dict.fromkeys(scanned)
            for seed in self.plan.seeds(noise)
        ]

    def featured(self) -> list[str]:
        """The tables of features that are merged."""
        return [
            self.files("image_features", protocol=protocol, noise=noise, seed=seed)
            for protocol, noise in self.plan.featured()
            for seed in self.plan.seeds(noise)
        ]

    def matched(self) -> list[str]:
        """Noise levels whose A a job finds: they are to meet a recording."""
        return [name for name, level in self.plan.config["noise"]["levels"].items() if "meets" in level]

    def level_files(self, levels: Iterable[str]) -> list[str]:
        """The files of those of these noise levels whose A a job finds."""
        return [self.files("matched_level", noise=noise) for noise in dict.fromkeys(levels) if noise in self.matched()]

    def boxed(self, protocol: str, bundle: Bundle) -> tuple[list[str], list[str]]:
        """Tables and masks of the ROIs that boxes are made around, one for each image; none without boxes."""
        if self.voxels(protocol) is None:
            return [], []
        tables, masks = zip(*(self.rois(protocol, noise, seed) for noise, seed in bundle), strict=True)
        return list(tables), list(masks)

    def group(self, bundle: Bundle) -> str:
        """Which jobs of a cluster a bundle's images and features may share.

        Those whose noise waits for other images do not go together with these.

        Parameters
        ----------
        bundle : tuple of (str, str)
            Noise level and seed of every image that one job makes.
        """
        waits = self.level_files(noise for noise, _ in bundle)
        return "matched_acquisitions" if waits else "acquisitions"

    def group_of(self, protocol: str, noise: str, seed: str) -> str:
        """The same of the bundle that one image is in."""
        return self.group(self._bundles[protocol, noise, seed])

    @cached_property
    def _bundles(self) -> Mapping[tuple[str, str, str], Bundle]:
        return {
            (protocol, *one): bundle
            for bundle, protocols in self.plan.bundles().items()
            for protocol in protocols
            for one in bundle
        }

    def image_physics(self, protocol: str) -> dict:
        """Effects that act on a protocol's images."""
        return self.plan.config["protocols"][protocol].get("image_physics", {})

    def found_in(self, protocol: str) -> str | None:
        """The recording or scanner whose physics it is scanned with."""
        return self.plan.config["protocols"][protocol].get("physics_from")

    def settings(self, protocol: str) -> dict:
        """Of its reconstruction."""
        settings = self.plan.config["reconstruction"][self.algorithm(protocol)]
        kernel = self.plan.config["protocols"][protocol].get("kernel")
        return settings if kernel is None else {**settings, "kernel": kernel}

    def voxels(self, protocol: str) -> dict | None:
        """A scanner's voxels that its images have; None: those of the study's grid."""
        return self.plan.config["protocols"][protocol].get("voxels")

    def rois(self, protocol: str, noise: str, seed: str) -> tuple[str, str]:
        """The table and the masks of the ROIs on the voxels of its images, where the phantom then lies."""
        label = self.plan.voxels_of(protocol)
        if seed in self.plan.moved(noise):
            known = {"seed": seed, "voxels": label or GRID}
            return self.files("moved_table", **known), self.files("moved_rois", **known)
        if label:
            return self.files("voxel_table", voxels=label), self.files("voxel_rois", voxels=label)
        return self.files("phantom_table"), self.files("phantom_rois")

    def algorithm(self, protocol: str) -> str:
        """Of its reconstruction."""
        return self.plan.config["protocols"][protocol]["algorithm"]

    def gpus(self, protocol: str, engine: str) -> int:
        """How many its reconstruction takes."""
        return int(engine == "astra_cuda" and self.algorithm(protocol) == "sirt")
