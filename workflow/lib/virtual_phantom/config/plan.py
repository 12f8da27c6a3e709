"""Which acquisitions a study needs: protocols x noise levels x seeds, and how jobs share them out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

# Settings of a scan that came after scores were kept: at these values they change none of them.
LATER = {"beam": "divergent", "detector": "flat", "arc_radius_mm": None, "flying_focal_spot": None}


OF_PHYSICS = ("physics", "image_physics", "physics_from")
WITHOUT_PHYSICS = "_without_physics"  # what the name of a protocol gets that is scanned without its effects too


def without_physics(protocols: Mapping[str, Mapping]) -> dict[str, dict]:
    """Protocols with a group, as they are without the effects that they have.

    Parameters
    ----------
    protocols : mapping of str to mapping
        By name.

    Returns
    -------
    dict of str to dict
        By a name of their own, without a group.
    """
    return {
        f"{name}{WITHOUT_PHYSICS}": {key: of for key, of in settings.items() if key not in ("group", *OF_PHYSICS)}
        for name, settings in protocols.items()
        if "group" in settings and any(settings.get(key) for key in OF_PHYSICS)
    }


def _without_later(geometry: dict) -> dict:
    scan = {key: value for key, value in geometry["scan"].items() if key not in LATER or value != LATER[key]}
    return geometry | {"scan": scan}


@dataclass(frozen=True)
class Plan:
    """All that the workflow has to know of a complete configuration (config.complete)."""

    config: dict

    def geometry_of(self, protocol: str) -> str:
        """Label of a protocol's geometry and physics. Protocols that differ in the reconstruction alone share it."""
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
        """What protocols of one geometry share.

        Parameters
        ----------
        label : str
            As `geometry_of` gives it.

        Returns
        -------
        dict
            {scan: the whole scan section, projections: int, physics: {effect: parameters}}, and physics_from where that
            is what a diagnosis finds.

        Raises
        ------
        KeyError
            For a label that no protocol has.
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
        """Whether scans of a geometry have effects, stated or to be found."""
        settings = self.geometry_settings(label)
        return bool(settings["physics"]) or "physics_from" in settings

    def voxels_of(self, protocol: str) -> str | None:
        """Label of a protocol's own voxels; None where its images lie on the study's grid."""
        if voxels := self.config["protocols"][protocol].get("voxels"):
            return "_".join(["voxels", *(f"{wide:g}".replace(".", "p") for wide in voxels["spacing_mm"])])
        return None

    def voxel_spacing(self, label: str) -> list[float] | None:
        """The voxel size of a label of `voxels_of`, mm (z, y, x); None for any other, such as the study's grid."""
        labelled = {self.voxels_of(protocol): of for protocol, of in self.config["protocols"].items() if "voxels" in of}
        return labelled[label]["voxels"]["spacing_mm"] if label in labelled else None

    def geometries(self) -> list[str]:
        """The labels of all geometries, sorted."""
        return sorted({self.geometry_of(protocol) for protocol in self.config["protocols"]})

    def seeds(self, noise: str) -> list[str]:
        """Two-digit seed labels of a noise level."""
        return [f"{seed:02d}" for seed in range(self.config["noise"]["levels"][noise]["repeats"])]

    def moved(self, noise: str) -> list[str]:
        """Seed labels of a noise level before which the phantom is re-positioned: the last."""
        seeds = self.seeds(noise)
        return seeds[max(len(seeds) - self.config["repeats"]["repositioned"], 0) :]

    def still(self, noise: str) -> list[str]:
        """Seed labels of a noise level in which the phantom lies where it is said to."""
        return self.seeds(noise)[: len(self.seeds(noise)) - len(self.moved(noise))]

    def moved_scans(self) -> list[tuple[str, str]]:
        """Every (geometry, seed) of a re-positioned repeat that some analysis asks for, sorted."""
        wanted = self.acquisitions()
        return sorted({(self.geometry_of(protocol), seed) for protocol, noise in wanted for seed in self.moved(noise)})

    def seed_batches(self) -> dict[tuple[str, ...], list[str]]:
        """Every batch of seeds that one job handles, and the noise levels that have it."""
        size = self.config["seeds_per_job"]
        batches: dict[tuple[str, ...], list[str]] = {}
        for noise in self.config["noise"]["levels"]:
            seeds = self.seeds(noise)
            for start in range(0, len(seeds), size):
                batches.setdefault(tuple(seeds[start : start + size]), []).append(noise)
        return batches

    def bundles(self) -> dict[tuple[tuple[str, str], ...], list[str]]:
        """Every bundle of (noise level, seed) that one job reconstructs, and the protocols that have it.

        Levels are kept whole where seeds_per_job allows, and fill bundles up in the order of noise.levels: realisations
        are lanes, and full registers cost no more. Which levels go together does not depend on which of them a
        protocol is asked for, so that another analysis does not repack what is there. Levels whose A is found from
        other images are never in one bundle with these.

        Returns
        -------
        dict of tuple to list of str
            {bundle: protocols}.
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
                if bundle := tuple(one for one in group if (protocol, one[0]) in wanted):
                    bundles.setdefault(bundle, []).append(protocol)
        return bundles

    def repeats(self, noise: list[str]) -> int:
        """Seeds that all of these noise levels have."""
        return min(self.config["noise"]["levels"][level]["repeats"] for level in noise)

    def groups(self) -> dict[str, int]:
        """{protocol: group number} of the stability analysis."""
        return {name: settings["group"] for name, settings in self.config["protocols"].items() if "group" in settings}

    def groups_without_physics(self) -> dict[str, int]:
        """The same of those that are scanned without their effects too, and of those that have none."""
        if not self.config["analyses"].get("stability", {}).get("without_physics"):
            return {}
        twins = without_physics(self.config["protocols"])
        named = {name: f"{name}{WITHOUT_PHYSICS}" for name in self.groups()}
        return {named[name] if named[name] in twins else name: group for name, group in self.groups().items()}

    def scored_settings(self) -> str:
        """Hash of every setting that the stability analysis' scores depend on, but for the seed; "" without one."""
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
                    **_without_later(self.geometry_settings(self.geometry_of(name))),
                }
                for name in self.groups()
            },
        }
        if self.config["repeats"]["repositioned"]:
            settings["repeats"] = self.config["repeats"]
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    def acquisitions(self) -> list[tuple[str, str]]:
        """Every (protocol, noise level) that some analysis asks for, sorted."""
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
        wanted |= {(one["protocol"], one["noise"]) for one in analyses.get("comparison", {}).values()}
        for selection in analyses.get("pca", {}).values():
            wanted |= {(protocol, noise) for protocol in selection["protocols"] for noise in selection["noise"]}
        return sorted(wanted)

    def featured(self) -> list[tuple[str, str]]:
        """Those of `acquisitions` whose features are used: all but the ones for the noise calibration alone."""
        calibration_only = Plan(
            {
                **self.config,
                "analyses": {
                    key: value for key, value in self.config["analyses"].items() if key != "noise_calibration"
                },
            }
        )
        return calibration_only.acquisitions()
