"""Images and measured data of each analysis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from ..base.settings import to_mapping
from ..config.dependencies import resource
from ..config.outputs import Files
from ..config.plan import Plan
from ..config.public_scans import COMPARED, made_folders
from ..config.settings import Analyses, Conditions
from ..statistics.dose_series import dose_variance
from .acquisitions import Acquisitions
from .phantom_sources import present


@dataclass(frozen=True)
class Selections:
    """Selections of images and measured data of one study."""

    plan: Plan
    files: Files
    acquisitions: Acquisitions

    @property
    def _analyses(self) -> Analyses:
        return self.plan.study.analyses

    def compared_images(self, groups: Mapping[str, int] | None = None) -> dict:
        """Return the images that are compared between groups of protocols: arguments of features.tables.read_groups.

        Parameters
        ----------
        groups : mapping of str to int, optional
            {protocol: group}; by default the groups of the stability analysis.
        """
        groups = self.plan.groups() if groups is None else groups
        levels = self.plan.compared_levels(groups)
        return {"groups": groups, "noise": levels, "seeds": self.plan.repeats(levels.values()) if levels else 0}

    @property
    def noise_control(self) -> bool:
        """Whether the stability analysis has the control with white noise instead of scans."""
        return bool(self._analyses.stability and self._analyses.stability.noise_control)

    def noise_control_images(self) -> dict[str, list[str]]:
        """Return {protocol: images of all repeats without re-positioning} of the control with white noise."""
        if not self.noise_control:
            return {}
        levels = self.plan.compared_levels()
        return {protocol: self.acquisitions.images(protocol, noise) for protocol, noise in levels.items()}

    def setting_images(self, protocol: str, noise: str) -> dict[str, list[str]]:
        """Return the images that one job extracts with another setting, with the ROIs of each (inputs of a rule)."""
        seeds = self.plan.seeds(noise)[: self.plan.extracted_repeats()]
        rois, masks = zip(*(self.acquisitions.rois(protocol, noise, seed) for seed in seeds), strict=True)
        images = [self.files("image", protocol=protocol, noise=noise, seed=seed) for seed in seeds]
        return {"images": images, "rois": list(rois), "masks": list(masks)}

    def setting_tables(self) -> list[str]:
        """Return the features of all compared extraction settings other than the study's."""
        return [
            self.files("setting_features", setting=name, protocol=protocol, noise=noise)
            for name in self.plan.variations
            for protocol, noise in self.plan.extracted_images()
        ]

    def score_conditions(self, recording: str) -> Conditions:
        """Return the values of condition columns that select the images for the scores of a recording."""
        return self._analyses.stability.where.get(recording, {}) if self._analyses.stability else {}

    @property
    def own_reference(self) -> str | None:
        """Recording of public scans of the phantom's object, if any. Its scores replace the published ones."""
        study, stability = self.plan.study, self._analyses.stability
        if study.public_scans.phantom is None or stability is None:
            return None
        made = made_folders(study.results)[COMPARED]
        return next((name for name in stability.recordings if study.recordings[name] == made), None)

    @property
    def measured_acquisitions(self) -> str | None:
        """Acquisitions of the printed phantom for `measured.load_score_draws`; None if they are not comparable."""
        study = self.plan.study
        if not study.measured.overlay:
            return None
        return "all" if study.repeats.repositioned else "fixed"

    def measured_scores(self) -> str:
        """Return the file of measured scores to compare with: scores of `own_reference`, or published scores."""
        if self.own_reference is not None:
            return self.files("scores", recording=self.own_reference)
        return resource("ct_phantom4radiomics_draws.csv")

    def sharing(self, groups: Mapping[str, int] | None = None) -> dict[int, str]:
        """Return {group: label} for `compared_images`, with the same label for protocols that share their noise.

        Protocols that reconstruct the same acquisitions share their noise. With common draws, all do.
        """
        draws, images = self.plan.study.noise.draws, self.compared_images(groups)
        return {
            images["groups"][protocol]: draws if draws == "common" else f"{self.plan.geometry_of(protocol)}/{noise}"
            for protocol, noise in images["noise"].items()
        }

    @property
    def cut_offs(self) -> dict | None:
        """Cut-offs of the measures of stability; None without a stability analysis."""
        return to_mapping(self._analyses.stability and self._analyses.stability.cut_offs)

    @property
    def calibrated(self) -> tuple[str, ...]:
        """Protocols of the noise calibration."""
        return self._analyses.noise_calibration.protocols if self._analyses.noise_calibration else ()

    @cached_property
    def calibration(self) -> list[tuple[str, str, str]]:
        """(protocol, noise level, seed) of all images of the noise calibration."""
        levels = self._analyses.noise_calibration.noise if self._analyses.noise_calibration else ()
        return [
            (protocol, noise, seed)
            for protocol in self.calibrated
            for noise in levels
            for seed in self.plan.nominal_seeds(noise)
        ]

    def calibration_images(self) -> list[str]:
        """Return the images of the noise calibration."""
        return [
            self.files("image", protocol=protocol, noise=noise, seed=seed) for protocol, noise, seed in self.calibration
        ]

    def calibration_rois(self) -> tuple[list[str], list[str]]:
        """Return tables and masks of the ROIs for each protocol of the noise calibration."""
        firsts = {protocol: (noise, seed) for protocol, noise, seed in reversed(self.calibration)}
        paths = [self.acquisitions.rois(name, *firsts[name]) for name in self.calibrated]
        return [table for table, _ in paths], [masks for _, masks in paths]

    def calibration_acquisitions(self) -> list[dict]:
        """Return protocol and acquisition settings of all images of the noise calibration."""
        return [
            {"protocol": protocol, **self.acquisitions.acquisition(noise, seed)}
            for protocol, noise, seed in self.calibration
        ]

    def pattern_images(self) -> dict[str, list[str]]:
        """Return {protocol: images} of the groups of the stability analysis, with the phantom at its nominal position.

        Empty if a noise level has too few of these images for the table of the fixed pattern.
        """
        return {name: self.acquisitions.images(name, noise) for name, noise in self.plan.pattern_noise().items()}

    def pattern_rois(self) -> dict[str, tuple[str, str]]:
        """Return {protocol: table and masks of the ROIs} for `pattern_images`."""
        return {
            name: self.acquisitions.rois(name, noise, self.plan.nominal_seeds(noise)[0])
            for name, noise in self.plan.pattern_noise().items()
        }

    def compared_noise(self) -> dict[str, float | None]:
        """Return {noise level: A} of the stability analysis; A is None if a job determines it."""
        return self._levels(*self.plan.compared_levels().values())

    def scan_noise(self) -> dict[str, float | None]:
        """Return {noise level: A} of the figure of scans; A is None if a job determines it."""
        return self._levels(self._analyses.optimal.noise) if self._analyses.optimal else {}

    def _levels(self, *names: str) -> dict[str, float | None]:
        return {name: self.plan.study.noise.levels[name].A for name in names}

    def study_levels(self) -> dict[str, float]:
        """Return {noise level: A} of the stability analysis if the configuration gives A."""
        return {noise: level for noise, level in self.compared_noise().items() if level is not None}

    def reference_tables(self, name: str) -> list[str]:
        """Return the tables of measured features that a figure of components shows."""
        if names := self._analyses.pca[name].recordings:
            return [self.files("recorded_features", recording=recording) for recording in names]
        measured = self.plan.study.measured
        if not measured.overlay:
            return []
        if measured.table is not None:
            return present([measured.table])
        return [resource("ct_phantom4radiomics_groups.csv")]

    def optimal_images(self) -> dict[str, list[str]]:
        """Return {algorithm: images of all repeats} of the figure of scans; {} without that figure."""
        optimal = self._analyses.optimal
        if optimal is None:
            return {}
        return {name: self.acquisitions.images(getattr(optimal, name), optimal.noise) for name in ("fbp", "sirt")}

    def scan_titles(self) -> dict[str, str]:
        """Return {algorithm: title} of the figure of scans."""
        protocols, optimal = self.plan.study.protocols, self._analyses.optimal
        return {
            algorithm: f"{protocols[getattr(optimal, algorithm)].reconstruction}, "
            f"{protocols[getattr(optimal, algorithm)].projections} projections"
            for algorithm in ("fbp", "sirt")
            if optimal
        }

    @cached_property
    def measured_noise(self) -> list[dict]:
        """Measured variances of the algorithms in the noise calibration."""
        if not self.plan.study.measured.overlay:
            return []
        reconstructions = {"sirt": "iterative", "fbp": "fbp"}
        algorithms = {self.plan.study.protocols[name].algorithm for name in self.calibrated}
        return [
            {
                "label": f"{dose} mGy, {'FBP' if algorithm == 'fbp' else 'iterative'}",
                "variance_hu2": dose_variance(reconstructions[algorithm], dose),
            }
            for algorithm in sorted(algorithms, reverse=True)
            for dose in (1, 3, 10)
        ]
