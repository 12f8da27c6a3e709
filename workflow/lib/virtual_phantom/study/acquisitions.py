"""Files and settings of the study's acquisitions, and their grouping on a cluster."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from ..base.settings import FbpSettings, ImageSettings, SirtSettings
from ..base.streams import random_start_angle_deg
from ..config.outputs import Files
from ..config.plan import MOVED, Bundle, Plan

GRID = "grid"  # wildcard value for the voxels of the study, instead of a label of scanner voxels


@dataclass(frozen=True)
class Acquisitions:
    """Acquisitions of one study."""

    plan: Plan
    files: Files

    @property
    def noise(self) -> dict:
        """Noise settings of all acquisitions."""
        study = self.plan.study
        return {"model": study.noise.model, "draws": study.noise.draws, "study_seed": study.seed}

    def acquisition(self, noise: str, seed: str) -> dict:
        """Return the settings of one acquisition of a geometry. The noise level is None if a job determines it."""
        return {"noise": noise, "noise_level": self.plan.study.noise.levels[noise].A, "seed": int(seed)}

    def images(self, protocol: str, noise: str) -> list[str]:
        """Return the images of all seeds with the phantom at its nominal position."""
        return [
            self.files("image", protocol=protocol, noise=noise, seed=seed) for seed in self.plan.nominal_seeds(noise)
        ]

    def clean(self, geometry: str, noise: str, seed: str) -> str:
        """Return the noise-free line integrals of a scan."""
        if position := self.plan.position(noise, seed):
            return self.files("own_clean", geometry=geometry, position=position, seed=seed)
        return self.files("clean", geometry=geometry)

    def pose(self, seed: str) -> dict:
        """Return the arguments of phantom.repositioning.random_pose for a re-positioned repeat."""
        study = self.plan.study
        motion = {"shift_mm": study.repeats.shift_mm, "turn_deg": study.repeats.turn_deg}
        return {"study_seed": study.seed, "seed": int(seed), **motion}

    def start_angle_deg(self, seed: str) -> float:
        """Return the angle of the first view of a repeat, degrees; 0 if all repeats start there."""
        study = self.plan.study
        return random_start_angle_deg(study.seed, int(seed)) if study.repeats.start_angle == "random" else 0.0

    def scan_rois(self, scan: str) -> tuple[str, str]:
        """Return table and masks of the ROIs on the study's grid, for the file name of noise-free projections."""
        return self._rois(*_position_and_seed(scan), None)

    def scan_pose(self, scan: str) -> dict | None:
        """Return `pose` for the file name of noise-free projections; None at the nominal position."""
        position, seed = _position_and_seed(scan)
        return self.pose(seed) if position == MOVED else None

    def scan_start_angle_deg(self, scan: str) -> float:
        """Return `start_angle_deg` for the file name of noise-free projections; 0 for shared ones."""
        _, seed = _position_and_seed(scan)
        return self.start_angle_deg(seed) if seed else 0.0

    def positions(self) -> list[dict]:
        """Return all repeats of all noise levels, and whether the phantom is re-positioned."""
        return [
            {
                "noise": noise,
                "seed": int(seed),
                "repositioned": seed in self.plan.repositioned_seeds(noise),
                "pose": self.pose(seed),
            }
            for noise in self.plan.study.noise.levels
            for seed in self.plan.seeds(noise)
        ]

    def position_table(self) -> list[str]:
        """Return the table of positions, if the phantom is re-positioned."""
        return [self.files("positions")] if self.plan.study.repeats.repositioned else []

    def projections(self) -> list[str]:
        """Return the projections that keep_projections adds to the study."""
        if not self.plan.study.keep_projections:
            return []
        scanned = [(self.plan.geometry_of(protocol), noise) for protocol, noise in self.plan.acquisitions()]
        return [
            self.files("acquisition", geometry=geometry, noise=noise, seed=seed)
            for geometry, noise in dict.fromkeys(scanned)
            for seed in self.plan.seeds(noise)
        ]

    def feature_tables(self) -> list[str]:
        """Return the tables of features that are merged."""
        return [
            self.files("image_features", protocol=protocol, noise=noise, seed=seed)
            for protocol, noise in self.plan.acquisitions_with_features()
            for seed in self.plan.seeds(noise)
        ]

    def matched(self) -> list[str]:
        """Return the noise levels that are matched to a recording."""
        return [name for name, level in self.plan.study.noise.levels.items() if level.meets]

    def level_files(self, levels: Iterable[str]) -> list[str]:
        """Return the files of the matched noise levels among these levels."""
        return [self.files("matched_level", noise=noise) for noise in dict.fromkeys(levels) if noise in self.matched()]

    def rules(self, wanted: Iterable[tuple[str, str]] | None = None) -> list[tuple[Bundle, list[str], str]]:
        """Return the rules that make or read images: their bundle, the protocols in their paths, and a constraint.

        A rule for protocols with jobs of their own has the wildcard protocol, and a constraint for it.

        Parameters
        ----------
        wanted : iterable of (str, str), optional
            See Plan.bundles.
        """
        rules: list[tuple[Bundle, list[str], str]] = []
        single: dict[Bundle, list[str]] = {}
        for bundle, protocols in self.plan.jobs(wanted):
            if len(protocols) > 1:
                rules.append((bundle, protocols, "none"))
            else:
                single.setdefault(bundle, []).extend(protocols)
        return [(bundle, ["{protocol}"], "|".join(names)) for bundle, names in single.items()] + rules

    def kernels(self, protocol: str, bundle: Bundle) -> list[str]:
        """Return the markers of the compiled kernels that the reconstruction of a bundle needs."""
        step = self.plan.study.protocols[protocol].algorithm
        return [self.files("kernels", step=step, lanes=lanes) for lanes in self.plan.lanes(protocol, bundle)]

    def image_rois(self, protocols: Iterable[str], bundle: Bundle, boxes: bool = False) -> dict[str, list[str]]:
        """Return {rois: tables, masks: masks}, one for each image; with `boxes`, only of protocols with own voxels."""
        found = [
            self.rois(protocol, noise, seed)
            for protocol in protocols
            if self.plan.study.protocols[protocol].voxels or not boxes
            for noise, seed in bundle
        ]
        return {"rois": [table for table, _ in found], "masks": [masks for _, masks in found]}

    def group(self, bundle: Bundle) -> str:
        """Return the group of cluster jobs of a bundle.

        Bundles with a matched noise level have their own group, because they wait for other images.
        """
        matched = self.level_files(noise for noise, _ in bundle)
        return "matched_acquisitions" if matched else "acquisitions"

    def reconstruction(self, protocol: str) -> ImageSettings:
        """Return the settings of the images of a protocol."""
        reconstruction, settings = self.plan.study.reconstruction, self.plan.study.protocols[protocol]
        solver: SirtSettings | FbpSettings = reconstruction.sirt
        if settings.algorithm == "fbp":
            solver = replace(reconstruction.fbp, kernel=settings.kernel, noise_kernel=settings.noise_kernel)
        return ImageSettings(protocol, settings.algorithm, solver, settings.image_physics or {}, settings.voxels)

    def rois(self, protocol: str, noise: str, seed: str) -> tuple[str, str]:
        """Return table and masks of the ROIs on the voxels of an image, at the phantom's position in that image."""
        return self._rois(self.plan.position(noise, seed), seed, self.plan.voxels_of(protocol))

    def _rois(self, position: str, seed: str, label: str | None) -> tuple[str, str]:
        """Return table and masks of the ROIs for a position of Plan.position, on scanner voxels or the study's grid."""
        if position == MOVED:
            known = {"seed": seed, "voxels": label or GRID}
            return self.files("moved_table", **known), self.files("moved_rois", **known)
        if label:
            return self.files("voxel_table", voxels=label), self.files("voxel_rois", voxels=label)
        return self.files("phantom_table"), self.files("phantom_rois")


def _position_and_seed(scan: str) -> tuple[str, str]:
    """Return position (see Plan.position) and seed in the file name of noise-free projections; "" if shared."""
    name = scan.removeprefix("clean").removeprefix("_")
    return name[:-2], name[-2:]
