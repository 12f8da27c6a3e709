"""Which of the study's images, and which measured data, each analysis takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from ..config.dependencies import resource
from ..config.outputs import PCA, Files
from ..config.plan import Plan
from ..config.public_scans import COMPARED, made_folders
from ..statistics.dose_series import dose_variance
from .acquisitions import Acquisitions
from .phantom_sources import present


@dataclass(frozen=True)
class Selections:
    """Of one study."""

    plan: Plan
    files: Files
    acquisitions: Acquisitions

    @property
    def _analyses(self) -> dict:
        return self.plan.config["analyses"]

    @property
    def grouped(self) -> dict:
        """The images whose features are compared between groups of protocols."""
        noise = self._analyses.get("stability", {}).get("noise")
        return {"groups": self.plan.groups(), "noise": noise, "seeds": self.plan.repeats([noise]) if noise else 0}

    def scored(self, recording: str) -> dict:
        """Which of a recording's images its features are scored with: values of condition columns."""
        return self._analyses.get("stability", {}).get("where", {}).get(recording, {})

    @property
    def own_reference(self) -> str | None:
        """The recording of public scans that stands for the measured phantom: it is of the object that is scanned."""
        config = self.plan.config
        made = made_folders(config)[COMPARED] if "phantom" in config["public_scans"] else None
        named = self._analyses.get("stability", {}).get("recordings", [])
        return next((name for name in named if config["recordings"][name] == made), None)

    def measured_scores(self) -> str:
        """Scores that stand beside the simulated ones: of these scans, or those kept here."""
        if self.own_reference is not None:
            return self.files("scores", recording=self.own_reference)
        return resource("ct_phantom4radiomics_draws.csv")

    def sharing(self, groups: Mapping[str, int] | None = None) -> dict[str, str]:
        """Which protocols with a group have their noise in common.

        Those that reconstruct the same acquisitions do; with common draws all do.

        Parameters
        ----------
        groups : mapping of str to int, optional
            {protocol: group}; absent: those of the stability analysis.

        Returns
        -------
        dict of str to str
            {protocol: label}: the same label for protocols that share it.
        """
        draws = self.acquisitions.noise["draws"]
        return {
            protocol: draws if draws == "common" else self.plan.geometry_of(protocol)
            for protocol in (self.plan.groups() if groups is None else groups)
        }

    @property
    def cut_offs(self) -> dict | None:
        """From where on a measure calls a feature stable."""
        return self._analyses.get("stability", {}).get("cut_offs")

    @property
    def calibrated(self) -> list[str]:
        """Protocols of the noise calibration."""
        return self._analyses.get("noise_calibration", {"protocols": []})["protocols"]

    @cached_property
    def calibration(self) -> list[tuple[str, str, str]]:
        """(protocol, noise level, seed) of every image that the noise is calibrated with."""
        levels = self._analyses.get("noise_calibration", {"noise": []})["noise"]
        return [
            (protocol, noise, seed)
            for protocol in self.calibrated
            for noise in levels
            for seed in self.plan.still(noise)
        ]

    def calibration_images(self) -> list[str]:
        """Their files."""
        return [
            self.files("image", protocol=protocol, noise=noise, seed=seed) for protocol, noise, seed in self.calibration
        ]

    def calibration_rois(self) -> tuple[list[str], list[str]]:
        """Tables and masks of the ROIs on the voxels of each of these protocols' images."""
        firsts = {protocol: (noise, seed) for protocol, noise, seed in reversed(self.calibration)}
        places = [self.acquisitions.rois(name, *firsts[name]) for name in self.calibrated]
        return [table for table, _ in places], [masks for _, masks in places]

    def calibration_acquisitions(self) -> list[dict]:
        """How they were acquired."""
        return [
            {"protocol": protocol, **self.acquisitions.one(noise, seed)} for protocol, noise, seed in self.calibration
        ]

    def compared_noise(self) -> dict[str, float | None]:
        """{noise level: A} of the stability analysis; None where a job finds A."""
        return self._levels(self._analyses.get("stability", {}).get("noise"))

    def scan_noise(self) -> dict[str, float | None]:
        """The same of the figure of scans."""
        return self._levels(self._analyses.get("optimal", {}).get("noise"))

    def _levels(self, noise: str | None) -> dict[str, float | None]:
        levels = self.plan.config["noise"]["levels"]
        return {noise: levels[noise].get("A")} if noise in levels else {}

    def study_levels(self) -> dict[str, float]:
        """{noise level: A} of the stability analysis, where its A is stated."""
        return {noise: level for noise, level in self.compared_noise().items() if level is not None}

    @property
    def shown_components(self) -> tuple[str, ...]:
        """Selections that analyses.pca may have: each has a figure of its own."""
        return PCA

    def components(self, name: str) -> dict:
        """The images whose principal components a figure shows."""
        chosen = self._analyses["pca"][name]
        return {
            "protocols": chosen["protocols"],
            "noise": chosen["noise"],
            "seeds": self.plan.repeats(chosen["noise"]),
        }

    def fitted(self, name: str) -> dict:
        """How its components are fitted."""
        return {key: self._analyses["pca"][name][key] for key in ("fit_on", "standardise")}

    def markers(self, name: str) -> list[str]:
        """Condition columns by which its measured markers are told apart; empty: all, and no colours."""
        return self._analyses["pca"][name]["by"]

    def references(self, name: str) -> list[str]:
        """Recordings that it shows."""
        return self._analyses["pca"][name]["recordings"]

    def reference_tables(self, name: str) -> list[str]:
        """The measured features that it shows: of recordings, or those kept here."""
        if names := self.references(name):
            return [self.files("recorded_features", recording=recording) for recording in names]
        measured = self.plan.config["measured"]
        if not measured["overlay"]:
            return []
        if measured["table"] is not None:
            return present([measured["table"]])
        return [resource("ct_phantom4radiomics_groups.csv")]

    def optimal_images(self) -> dict[str, list[str]]:
        """{algorithm: all repeats} of the two images of the figure of scans; nothing without one."""
        if "optimal" not in self._analyses:
            return {}
        optimal = self._analyses["optimal"]
        return {
            algorithm: self.acquisitions.images(optimal[algorithm], optimal["noise"]) for algorithm in ("fbp", "sirt")
        }

    def scan_titles(self) -> dict[str, str]:
        """What those two are called."""
        protocols, optimal = self.plan.config["protocols"], self._analyses.get("optimal", {})
        return {
            algorithm: f"{algorithm.upper()}, {protocols[optimal[algorithm]]['projections']} projections"
            for algorithm in ("fbp", "sirt")
            if optimal
        }

    @cached_property
    def measured_noise(self) -> list[dict]:
        """The measured variances of the algorithms that the noise is calibrated with."""
        if not self.plan.config["measured"]["overlay"]:
            return []
        reconstructions = {"sirt": "iterative", "fbp": "fbp"}
        return [
            {
                "label": f"{dose} mGy, {'FBP' if algorithm == 'fbp' else 'iterative'}",
                "variance_hu2": dose_variance(reconstructions[algorithm], dose),
            }
            for algorithm in sorted({self.acquisitions.algorithm(name) for name in self.calibrated}, reverse=True)
            for dose in (1, 3, 10)
        ]
