"""Plan of a study: its acquisitions (protocols x noise levels x seeds) and their distribution over jobs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

# Keys of a scan that are newer than the saved scores. With these values they are not part of the hash of the settings.
NEWER_KEYS = {"beam": "divergent", "detector": "flat", "arc_radius_mm": None, "flying_focal_spot": None}

PHYSICS_KEYS = ("physics", "image_physics", "physics_from")
WITHOUT_PHYSICS = "_without_physics"  # suffix of protocols that are copies without effects


def without_physics(protocols: Mapping[str, Mapping]) -> dict[str, dict]:
    """Return copies without effects and group of the protocols with a group and effects, under new names."""
    return {
        f"{name}{WITHOUT_PHYSICS}": {k: value for k, value in settings.items() if k not in ("group", *PHYSICS_KEYS)}
        for name, settings in protocols.items()
        if "group" in settings and any(settings.get(key) for key in PHYSICS_KEYS)
    }


def _without_newer_keys(geometry: dict) -> dict:
    scan = {key: value for key, value in geometry["scan"].items() if key not in NEWER_KEYS or value != NEWER_KEYS[key]}
    return geometry | {"scan": scan}


@dataclass(frozen=True)
class Plan:
    """Acquisitions of a complete configuration (config.complete)."""

    config: dict

    def geometry_of(self, protocol: str) -> str:
        """Return the label of a protocol's geometry and physics. Reconstructions of the same scan share it."""
        settings = self.config["protocols"][protocol]
        scan, physics = settings.get("scan"), settings.get("physics")
        label = f"{scan}_views{settings['projections']}" if scan else f"views{settings['projections']}"
        if physics:
            text = json.dumps(physics, sort_keys=True)
            label += f"_physics_{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        if found := settings.get("physics_from"):
            label += f"_physics_of_{found}"
        return label

    def geometry_settings(self, label: str) -> dict:
        """Return the settings of a geometry by its label (see `geometry_of`).

        They are scan (complete section), projections, physics {effect: parameters}, and physics_from for physics that a
        diagnosis finds.

        Raises
        ------
        KeyError
            For an unknown label.
        """
        for protocol, settings in self.config["protocols"].items():
            if self.geometry_of(protocol) == label:
                name = settings.get("scan")
                found = {"physics_from": settings["physics_from"]} if "physics_from" in settings else {}
                return {
                    "scan": self.config["scans"][name] if name else self.config["scan"],
                    "projections": settings["projections"],
                    "physics": settings.get("physics") or {},
                    **found,
                }
        raise KeyError(label)

    def has_physics(self, label: str) -> bool:
        """Whether scans of a geometry have effects, from the configuration or from a diagnosis."""
        settings = self.geometry_settings(label)
        return bool(settings["physics"]) or "physics_from" in settings

    def voxels_of(self, protocol: str) -> str | None:
        """Return the label of a protocol's own voxels; None if its images are on the study's grid."""
        if voxels := self.config["protocols"][protocol].get("voxels"):
            return "_".join(["voxels", *(f"{size:g}".replace(".", "p") for size in voxels["spacing_mm"])])
        return None

    def voxel_spacing(self, label: str) -> list[float] | None:
        """Return the voxel size of a label of `voxels_of`, mm (z, y, x); None for other labels."""
        for protocol, settings in self.config["protocols"].items():
            if "voxels" in settings and self.voxels_of(protocol) == label:
                return settings["voxels"]["spacing_mm"]
        return None

    def geometries(self) -> list[str]:
        """Return the labels of all geometries, sorted."""
        return sorted({self.geometry_of(protocol) for protocol in self.config["protocols"]})

    def seeds(self, noise: str) -> list[str]:
        """Return the two-digit seed labels of a noise level."""
        return [f"{seed:02d}" for seed in range(self.config["noise"]["levels"][noise]["repeats"])]

    def moved(self, noise: str) -> list[str]:
        """Return the seed labels of a noise level with a re-positioned phantom, which are the last."""
        seeds = self.seeds(noise)
        return seeds[max(len(seeds) - self.config["repeats"]["repositioned"], 0) :]

    def still(self, noise: str) -> list[str]:
        """Return the seed labels of a noise level with the phantom at its nominal position."""
        return self.seeds(noise)[: len(self.seeds(noise)) - len(self.moved(noise))]

    def moved_scans(self) -> list[tuple[str, str]]:
        """Return (geometry, seed) of every re-positioned repeat that an analysis needs, sorted."""
        wanted = self.acquisitions()
        return sorted({(self.geometry_of(protocol), seed) for protocol, noise in wanted for seed in self.moved(noise)})

    def seed_batches(self) -> dict[tuple[str, ...], list[str]]:
        """Return {batch of seeds of one job: noise levels that have it}."""
        size = self.config["seeds_per_job"]
        batches: dict[tuple[str, ...], list[str]] = {}
        for noise in self.config["noise"]["levels"]:
            seeds = self.seeds(noise)
            for start in range(0, len(seeds), size):
                batches.setdefault(tuple(seeds[start : start + size]), []).append(noise)
        return batches

    def bundles(self) -> dict[tuple[tuple[str, str], ...], list[str]]:
        """Return {bundle of (noise level, seed) that one job reconstructs: protocols that have it}.

        Realizations are lanes of vector registers, so that full bundles cost no more. A noise level stays in one bundle
        if seeds_per_job allows, and levels fill the bundles in the order of noise.levels. The grouping is the same for
        all protocols, so that a further analysis does not change existing bundles. Levels whose A is matched to other
        images are never in one bundle with those images.
        """
        size = self.config["seeds_per_job"]
        levels = self.config["noise"]["levels"]
        together: list[list[tuple[str, str]]] = []
        for noise in levels:
            seeds = [(noise, seed) for seed in self.seeds(noise)]
            for part in (seeds[start : start + size] for start in range(0, len(seeds), size)):
                last = together[-1] if together else []
                alike = last and ("meets" in levels[last[-1][0]]) == ("meets" in levels[noise])
                if alike and len(last) + len(part) <= size:
                    last += part
                else:
                    together.append(part)
        wanted = self.acquisitions()
        bundles: dict[tuple[tuple[str, str], ...], list[str]] = {}
        for protocol in self.config["protocols"]:
            for group in together:
                if bundle := tuple((noise, seed) for noise, seed in group if (protocol, noise) in wanted):
                    bundles.setdefault(bundle, []).append(protocol)
        return bundles

    def repeats(self, noise: list[str]) -> int:
        """Return the number of seeds that all of these noise levels have."""
        return min(self.config["noise"]["levels"][level]["repeats"] for level in noise)

    def groups(self) -> dict[str, int]:
        """Return {protocol: group number} of the stability analysis."""
        return {name: settings["group"] for name, settings in self.config["protocols"].items() if "group" in settings}

    def groups_without_physics(self) -> dict[str, int]:
        """Return {protocol: group number} with each protocol replaced by its copy without effects, if it has one."""
        if not self.config["analyses"].get("stability", {}).get("without_physics"):
            return {}
        copies = without_physics(self.config["protocols"])
        names = {name: f"{name}{WITHOUT_PHYSICS}" for name in self.groups()}
        return {names[name] if names[name] in copies else name: group for name, group in self.groups().items()}

    def scored_settings(self) -> str:
        """Return a hash of all settings except the seed that affect the stability scores; "" without that analysis."""
        if "stability" not in self.config["analyses"]:
            return ""
        noise = {key: value for key, value in self.config["noise"].items() if key != "levels"}
        level = self.config["noise"]["levels"][self.config["analyses"]["stability"]["noise"]]
        keys = ("phantom", "grid", "mu_water_per_mm", "materials", "reconstruction", "statistics")
        settings = {
            **{key: self.config[key] for key in keys},
            "noise": {**noise, "level": level},
            "protocols": {
                name: {
                    **self.config["protocols"][name],
                    **_without_newer_keys(self.geometry_settings(self.geometry_of(name))),
                }
                for name in self.groups()
            },
        }
        if self.config["repeats"]["repositioned"]:
            settings["repeats"] = self.config["repeats"]
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    def acquisitions(self) -> list[tuple[str, str]]:
        """Return every (protocol, noise level) that an analysis needs, sorted."""
        analyses = self.config["analyses"]
        wanted = set()
        if "stability" in analyses:
            compared = {**self.groups(), **self.groups_without_physics()}
            wanted |= {(protocol, analyses["stability"]["noise"]) for protocol in compared}
        if "optimal" in analyses:
            wanted |= {(analyses["optimal"][algorithm], analyses["optimal"]["noise"]) for algorithm in ("sirt", "fbp")}
        if "noise_calibration" in analyses:
            calibration = analyses["noise_calibration"]
            wanted |= {(protocol, noise) for protocol in calibration["protocols"] for noise in calibration["noise"]}
        comparisons = analyses.get("comparison", {}).values()
        wanted |= {(comparison["protocol"], comparison["noise"]) for comparison in comparisons}
        for selection in analyses.get("pca", {}).values():
            wanted |= {(protocol, noise) for protocol in selection["protocols"] for noise in selection["noise"]}
        return sorted(wanted)

    def featured(self) -> list[tuple[str, str]]:
        """Return the acquisitions whose features are used: all except those for the noise calibration only."""
        analyses = {key: value for key, value in self.config["analyses"].items() if key != "noise_calibration"}
        return Plan({**self.config, "analyses": analyses}).acquisitions()
