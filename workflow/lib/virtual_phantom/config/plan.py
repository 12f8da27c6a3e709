"""Plan of a study: its acquisitions (protocols x noise levels x seeds) and their distribution over jobs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..base.settings import ScanSettings, SirtSettings, to_mapping
from ..features.variations import Variation, variations
from ..io.yaml_files import read_yaml
from ..physics.scenes.object_files import object_path
from ..statistics import MINIMUM_REPEATS
from .settings import Analyses, Effects, Protocol, Study

# Keys that are newer than the saved scores. With these values, which give the results before the keys, they are not
# part of the hash of the settings.
NEWER_KEYS = {
    **{"beam": "divergent", "detector": "flat", "arc_radius_mm": None, "flying_focal_spot": None, "samples": 1},
    "tolerance_hu": 0,
}

Bundle = tuple[tuple[str, str], ...]  # (noise level, seed) of all realizations that one job computes

WHOLE_REGIONS = {"parameters": None, "section": "whole", "stored_offset_hu": 0}  # features by default

MOVED, STILL = "seed", "angle"  # in file names: re-positioned repeats, and others with their own start angle
NO_PHYSICS = {"physics": None, "image_physics": None, "physics_from": None}
WITHOUT_PHYSICS = "_without_physics"  # suffix of protocols that are copies without effects


def without_physics(protocols: Mapping[str, Protocol]) -> dict[str, Protocol]:
    """Return copies without effects and group of the protocols with a group and effects, under new names."""
    return {
        f"{name}{WITHOUT_PHYSICS}": replace(protocol, group=None, **NO_PHYSICS)
        for name, protocol in protocols.items()
        if protocol.group is not None and any(getattr(protocol, key) for key in NO_PHYSICS)
    }


def _without_newer_keys(section: ScanSettings | SirtSettings) -> dict:
    return {key: value for key, value in to_mapping(section).items() if NEWER_KEYS.get(key, ...) != value}


@dataclass(frozen=True)
class GeometrySettings:
    """Settings of the scans of a geometry: the scanner, views, and effects as stated or from a diagnosis."""

    scan: ScanSettings
    projections: int
    physics: Effects
    physics_from: str | None = None


@dataclass(frozen=True)
class Plan:
    """Acquisitions of a study."""

    study: Study

    def geometry_of(self, protocol: str) -> str:
        """Return the label of a protocol's geometry and physics. Reconstructions of the same scan share it."""
        settings = self.study.protocols[protocol]
        label = f"{settings.scan}_views{settings.projections}" if settings.scan else f"views{settings.projections}"
        if settings.physics:
            text = json.dumps(settings.physics, sort_keys=True)
            label += f"_physics_{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        if settings.physics_from:
            label += f"_physics_of_{settings.physics_from}"
        return label

    def scan_of(self, protocol: str) -> ScanSettings:
        """Return the scanner of a protocol."""
        name = self.study.protocols[protocol].scan
        return self.study.scans[name] if name else self.study.scan

    def geometry_settings(self, label: str) -> GeometrySettings:
        """Return the settings of a geometry by its label (see `geometry_of`).

        Raises
        ------
        KeyError
            For an unknown label.
        """
        for name, protocol in self.study.protocols.items():
            if self.geometry_of(name) == label:
                return GeometrySettings(
                    self.scan_of(name), protocol.projections, protocol.physics or {}, protocol.physics_from
                )
        raise KeyError(label)

    def has_physics(self, label: str) -> bool:
        """Return whether the chain of effects simulates a geometry: with effects, or several rays per pixel."""
        settings = self.geometry_settings(label)
        return bool(settings.physics or settings.physics_from or settings.scan.samples > 1)

    def voxels_of(self, protocol: str) -> str | None:
        """Return the label of a protocol's own voxels; None if its images are on the study's grid."""
        if voxels := self.study.protocols[protocol].voxels:
            return "_".join(["voxels", *(f"{size:g}".replace(".", "p") for size in voxels.spacing_mm)])
        return None

    def voxel_spacing(self, label: str) -> tuple[float, ...] | None:
        """Return the voxel size of a label of `voxels_of`, mm (z, y, x); None for other labels."""
        for name, protocol in self.study.protocols.items():
            if protocol.voxels and self.voxels_of(name) == label:
                return protocol.voxels.spacing_mm
        return None

    @property
    def voxel_sizes(self) -> list[tuple[float, ...]]:
        """Return the voxel sizes of all protocols, mm (z, y, x), sorted."""
        own = (protocol.voxels.spacing_mm if protocol.voxels else None for protocol in self.study.protocols.values())
        return sorted({tuple(size or self.study.grid.spacing_mm) for size in own})

    def seeds(self, noise: str) -> list[str]:
        """Return the two-digit seed labels of a noise level."""
        return [f"{seed:02d}" for seed in range(self.study.noise.levels[noise].repeats)]

    def repositioned_seeds(self, noise: str) -> list[str]:
        """Return the seed labels of a noise level with a re-positioned phantom, which are the last."""
        seeds = self.seeds(noise)
        return seeds[max(len(seeds) - self.study.repeats.repositioned, 0) :]

    def nominal_seeds(self, noise: str) -> list[str]:
        """Return the seed labels of a noise level with the phantom at its nominal position."""
        return self.seeds(noise)[: len(self.seeds(noise)) - len(self.repositioned_seeds(noise))]

    def levels_of(self, protocol: str, levels: Iterable[str]) -> tuple[str, ...]:
        """Return the noise levels among `levels` at which a protocol is scanned."""
        own = self.study.protocols[protocol].noise
        return tuple(noise for noise in levels if own is None or noise in own)

    def compared_levels(self, protocols: Iterable[str] | None = None) -> dict[str, str]:
        """Return {protocol: noise level} at which the stability analysis compares protocols.

        Parameters
        ----------
        protocols : iterable of str, optional
            By default those with a group.
        """
        stability = self.study.analyses.stability
        names = self.groups() if protocols is None else protocols
        return {name: self.levels_of(name, stability.noise)[0] for name in names} if stability else {}

    def pattern_noise(self) -> dict[str, str]:
        """Return `compared_levels` for the table of the fixed pattern; {} if a level has too few repeats for it."""
        levels = self.compared_levels()
        enough = all(len(self.nominal_seeds(noise)) >= MINIMUM_REPEATS for noise in levels.values())
        return levels if enough else {}

    def position(self, noise: str, seed: str) -> str:
        """Return MOVED or STILL for a repeat with own noise-free projections, "" for one with the shared ones."""
        if seed in self.repositioned_seeds(noise):
            return MOVED
        return STILL if self.study.repeats.start_angle == "random" else ""

    def own_scans(self) -> list[tuple[str, str, str]]:
        """Return (geometry, position, seed) of all own noise-free projections that an analysis needs, sorted."""
        return [scan for scan in self._scans() if scan[1]]

    def shared_scans(self) -> list[str]:
        """Return the geometries with noise-free projections that several repeats share, sorted."""
        return sorted({geometry for geometry, position, _ in self._scans() if not position})

    def _scans(self) -> list[tuple[str, str, str]]:
        """Return (geometry, `position`, seed) of all scans that an analysis needs, sorted."""
        return sorted(
            {
                (self.geometry_of(protocol), self.position(noise, seed), seed)
                for protocol, noise in self.acquisitions()
                for seed in self.seeds(noise)
            }
        )

    def bundles(self, wanted: Iterable[tuple[str, str]] | None = None) -> dict[Bundle, list[str]]:
        """Return {bundle of (noise level, seed) that one job reconstructs: protocols that have it}.

        Realizations are lanes of vector registers, so that full bundles cost no more. A noise level stays in one bundle
        if seeds_per_job allows, and levels fill the bundles in the order of noise.levels. The grouping is the same for
        all protocols, so that a further analysis does not change existing bundles. Levels whose A is matched to other
        images are never in one bundle with those images.

        Parameters
        ----------
        wanted : iterable of (str, str), optional
            Protocols and noise levels. Default: `acquisitions`.
        """
        size = self.study.seeds_per_job
        levels = self.study.noise.levels
        together: list[list[tuple[str, str]]] = []
        for noise in levels:
            seeds = [(noise, seed) for seed in self.seeds(noise)]
            for part in (seeds[start : start + size] for start in range(0, len(seeds), size)):
                last = together[-1] if together else []
                alike = last and (levels[last[-1][0]].meets is None) == (levels[noise].meets is None)
                if alike and len(last) + len(part) <= size:
                    last += part
                else:
                    together.append(part)
        wanted = set(self.acquisitions() if wanted is None else wanted)
        bundles: dict[Bundle, list[str]] = {}
        for protocol in self.study.protocols:
            for group in together:
                if bundle := tuple((noise, seed) for noise, seed in group if (protocol, noise) in wanted):
                    bundles.setdefault(bundle, []).append(protocol)
        return bundles

    def jobs(self, wanted: Iterable[tuple[str, str]] | None = None) -> list[tuple[Bundle, list[str]]]:
        """Return bundle and protocols of every job that reconstructs images or extracts their features.

        Protocols share a job if they have the same `job`, scan and bundle.

        Parameters
        ----------
        wanted : iterable of (str, str), optional
            See `bundles`.
        """
        jobs: dict[tuple, list[str]] = {}
        for bundle, protocols in self.bundles(wanted).items():
            for name in protocols:
                job = self.study.protocols[name].job
                jobs.setdefault((bundle, job or name, self.geometry_of(name) if job else None), []).append(name)
        return [(bundle, protocols) for (bundle, *_), protocols in jobs.items()]

    def lanes(self, protocol: str, bundle: Bundle) -> list[int]:
        """Return the numbers of realizations of a bundle that are reconstructed at once, sorted.

        They share the start angle; with filtered back-projection also the noise-free scan.
        """
        own = [seed if self.position(noise, seed) else "" for noise, seed in bundle]
        settings = self.study.reconstruction.fbp
        by_scan = self.study.protocols[protocol].algorithm == "fbp" and settings.normalise == "coverage"
        keys = own if by_scan or self.study.repeats.start_angle == "random" else [""] * len(own)
        return sorted({keys.count(key) for key in keys})

    def repeats(self, noise: Iterable[str]) -> int:
        """Return the number of seeds that all of these noise levels have."""
        return min(self.study.noise.levels[level].repeats for level in noise)

    def groups(self) -> dict[str, int]:
        """Return {protocol: group number} of the stability analysis."""
        protocols = self.study.protocols.items()
        return {name: protocol.group for name, protocol in protocols if protocol.group is not None}

    @cached_property
    def tissue_classes(self) -> dict[str, str]:
        """{ROI: tissue class}; empty if a file of the phantom has an error, which other checks report."""
        phantom = self.study.phantom
        if phantom.source == "ct":
            return {name: roi.tissue_class for roi in phantom.ct.rois for name in roi.names}
        if phantom.source == "object" and phantom.object.rois:
            return {roi.name: roi.tissue_class for roi in phantom.object.rois}
        try:
            path = object_path(phantom.object.kind) if phantom.source == "object" else phantom.layout
            rois = read_yaml(path or RESOURCES / "phantom.yaml", "give a file with rois")["rois"]
            return {str(roi["name"]): str(roi["tissue_class"]) for roi in rois}
        except (InputError, AttributeError, KeyError, TypeError):
            return {}

    @property
    def compares_protocols(self) -> bool:
        """Whether the stability analysis has at least two protocols."""
        return len(self.groups()) > 1

    @property
    def compares_classes(self) -> bool:
        """Whether the ROIs have at least two tissue classes."""
        return len(set(self.tissue_classes.values())) != 1

    @property
    def compares_extraction(self) -> bool:
        """Whether extraction settings are compared, which needs several ROIs or several conditions."""
        return bool(self.variations) and (len(self.tissue_classes) != 1 or len(self.extracted_images()) > 1)

    def groups_without_physics(self) -> dict[str, int]:
        """Return {protocol: group number} with each protocol replaced by its copy without effects, if it has one."""
        if not (self.study.analyses.stability and self.study.analyses.stability.without_physics):
            return {}
        copies = without_physics(self.study.protocols)
        names = {name: f"{name}{WITHOUT_PHYSICS}" for name in self.groups()}
        return {names[name] if names[name] in copies else name: group for name, group in self.groups().items()}

    def scored_settings(self) -> str:
        """Return a hash of all settings except the seed that affect the stability scores; "" without that analysis."""
        if self.study.analyses.stability is None:
            return ""
        study = to_mapping(self.study)
        levels = study["noise"].pop("levels")
        keys = ("phantom", "grid", "mu_water_per_mm", "materials", "reconstruction", "statistics", "noise")
        settings = {key: study[key] for key in keys}
        compared = self.compared_levels()
        del settings["reconstruction"]["sirt"]
        if any(self.study.protocols[name].algorithm == "sirt" for name in self.groups()):
            settings["reconstruction"]["sirt"] = _without_newer_keys(self.study.reconstruction.sirt)
        used = [levels[noise] for noise in dict.fromkeys(compared.values())]
        settings["noise"]["level"] = used[0] if len(used) == 1 else {name: levels[compared[name]] for name in compared}
        settings["protocols"] = {
            name: {
                **{key: value for key, value in study["protocols"][name].items() if key != "job"},
                **to_mapping(self.geometry_settings(self.geometry_of(name))),
                "scan": _without_newer_keys(self.scan_of(name)),
            }
            for name in self.groups()
        }
        if self.study.repeats.repositioned or self.study.repeats.start_angle == "random":
            settings["repeats"] = study["repeats"]
        if study["features"] != WHOLE_REGIONS:
            settings["features"] = study["features"]
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    def acquisitions(self) -> list[tuple[str, str]]:
        """Return every (protocol, noise level) that an analysis needs, sorted."""
        return self._acquisitions(self.study.analyses)

    def _acquisitions(self, analyses: Analyses) -> list[tuple[str, str]]:
        wanted = set()
        if stability := analyses.stability:
            wanted |= set(self.compared_levels({**self.groups(), **self.groups_without_physics()}).items())
            wanted |= {(name, noise) for name in self.groups() for noise in self.levels_of(name, stability.noise)}
        if analyses.extraction:
            wanted |= set(self.extracted_images())
        if optimal := analyses.optimal:
            wanted |= {(optimal.sirt, optimal.noise), (optimal.fbp, optimal.noise)}
        if calibration := analyses.noise_calibration:
            wanted |= set(product(calibration.protocols, calibration.noise))
        wanted |= {(comparison.protocol, comparison.noise) for comparison in analyses.comparison.values()}
        for selection in analyses.pca.values():
            wanted |= set(product(selection.protocols, selection.noise))
        return sorted(wanted)

    @cached_property
    def variations(self) -> dict[str, Variation]:
        """Extraction settings that `analyses.extraction` compares with the study's, by name."""
        axis, features = self.study.analyses.extraction, self.study.features
        if axis is None:
            return {}
        from ..features.settings import read_extraction  # slow import (pandas)

        return variations(to_mapping(axis), read_extraction(features.parameters), features.section)

    def extracted_repeats(self) -> int:
        """Return the number of seeds of each acquisition of `extracted_images`."""
        return self.repeats(noise for _, noise in self.extracted_images())

    def extracted_images(self) -> list[tuple[str, str]]:
        """Return every (protocol, noise level) of the comparison of extraction settings."""
        axis, stability = self.study.analyses.extraction, self.study.analyses.stability
        levels = (axis.noise or (stability.noise if stability else ())) if axis else ()
        protocols = (axis.protocols or self.groups()) if axis else ()
        return [(protocol, noise) for protocol in protocols for noise in self.levels_of(protocol, levels)]

    def acquisitions_with_features(self) -> list[tuple[str, str]]:
        """Return the acquisitions whose features are used: all except those for the noise calibration only."""
        return self._acquisitions(replace(self.study.analyses, noise_calibration=None))
