"""Jobs that follow feature extraction: statistics, figures, and comparisons with recordings."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from ..config.outputs import BY_NAME, Output
from ..config.plan import Plan
from ..config.settings import Stability


@dataclass(frozen=True)
class AnalysisJob:
    """One job."""

    outputs: tuple[Output, ...]
    known: dict[str, str]  # wildcards of all outputs
    images: int = 0  # that it reads

    @property
    def files(self) -> tuple[str, ...]:
        """Output files, relative to results_dir."""
        return tuple(path for output in self.outputs for path in output.paths(**self.known))


def jobs(plan: Plan) -> Iterator[AnalysisJob]:
    """Yield all jobs that a configuration needs after feature extraction.

    Jobs that read recordings have the stage "recordings", because the configuration does not contain their size.
    """
    yield _job("figure_rois")
    if plan.study.repeats.repositioned:
        yield _job("positions")
    analyses = plan.study.analyses
    if featured := plan.acquisitions_with_features():
        yield _job("features", images=sum(len(plan.seeds(noise)) for _, noise in featured))
    if analyses.optimal:
        yield _job("figure_scans")
    if calibration := analyses.noise_calibration:
        images = len(calibration.protocols) * sum(len(plan.nominal_seeds(noise)) for noise in calibration.noise)
        yield _job("noise_calibration", images=images)
        yield _job("figure_noise_calibration")
    if analyses.stability and analyses.stability.noise_control and plan.compares_protocols:
        images = sum(len(plan.seeds(noise)) for noise in plan.compared_levels().values())
        yield _job("noise_control", images=images)
    if analyses.stability:
        yield from _stability(plan, analyses.stability)
        if levels := plan.pattern_noise():
            yield _job("fixed_pattern", images=sum(len(plan.nominal_seeds(noise)) for noise in levels.values()))
    if plan.compares_extraction:
        for setting in plan.variations:
            for protocol, noise in plan.extracted_images():
                known = {"setting": setting, "protocol": protocol, "noise": noise}
                yield _job("setting_features", images=plan.extracted_repeats(), **known)
        yield _job("extraction_features", "extraction_settings", "extraction_choice")
    for name in analyses.pca if plan.compares_classes else ():
        yield _job("pca", "separability", pca=name)
        yield _job(f"figure_pca_{name}")
    with_recordings = list(_recording_jobs(plan))
    yield from with_recordings
    if featured or analyses.noise_calibration or with_recordings:
        yield _job("parquet", table="features")
    yield _job("index")


def figures(plan: Plan) -> list[tuple[Output, dict[str, str]]]:
    """Return (figure, wildcards) for all figures of a configuration."""
    return [(output, known) for output, known in _outputs(plan) if output.pattern.startswith("figures/")]


def tables(plan: Plan) -> list[tuple[Output, dict[str, str]]]:
    """Return (table, wildcards) for all tables of a configuration, features first."""
    outputs = _outputs(plan)
    features = [(output, known) for output, known in outputs if output.name == "features"]
    return features + [(output, known) for output, known in outputs if re.fullmatch(r"tables/.*\.csv", output.pattern)]


def _outputs(plan: Plan) -> list[tuple[Output, dict[str, str]]]:
    return [(output, job.known) for job in jobs(plan) for output in job.outputs]


def _job(*names: str, images: int = 0, **known: str) -> AnalysisJob:
    return AnalysisJob(tuple(BY_NAME[name] for name in names), known, images)


def impossible(plan: Plan) -> list[str]:
    """Return a sentence for each analysis that the configuration requests and its ROIs or protocols do not allow."""
    analyses, classes, sentences = plan.study.analyses, plan.tissue_classes, []
    if analyses.stability and not plan.compares_protocols:
        sentences.append(
            f"Stability between protocols: not possible, since only {next(iter(plan.groups()))} has a group. The "
            "measures compare its repeats. Give a second protocol a group."
        )
    if not plan.compares_classes and (analyses.stability or analyses.pca):
        name = next(iter(classes.values()))
        reason = "the study has one ROI" if len(classes) == 1 else f"all ROIs have the tissue class {name}"
        sentences.append(
            f"Discriminative power, rankings and principal components: not possible, since {reason}. Add an ROI of "
            "another tissue."
        )
    if analyses.stability and len(classes) == 1:
        others = "W, CV or QCD" if plan.compares_protocols else "CV or QCD"
        sentences.append(f"ICC and CCC: not possible, since they compare several ROIs. Use {others}.")
    if plan.variations and not plan.compares_extraction:
        sentences.append(
            "Extraction settings: not compared, since one ROI in one protocol and noise level has no measure of "
            "robustness."
        )
    return sentences


def _stability(plan: Plan, stability: Stability) -> Iterator[AnalysisJob]:
    yield _job("stability_measures", "stable_features")
    yield _job("trust", "robust_features")
    if plan.compares_protocols or len(plan.tissue_classes) != 1:
        yield _job("figure_trust_map")
    if not plan.compares_protocols:
        return
    yield _job("stability", "controls")
    if stability.without_physics:
        yield _job("physics_change")
        yield _job("figure_physics_change")
    if not plan.compares_classes:
        return
    yield _job("top_features")
    yield _job("figure_stability_discrimination")
    if plan.study.measured.overlay:
        yield _job("overlap")
        yield _job("figure_overlap")
    for name in stability.recordings:
        yield _job("scores", recording=name)
        yield _job("stability_beside", recording=name)
        yield _job("overlap_recording", recording=name)
        yield _job("figure_overlap_recording", recording=name)


def _recording_jobs(plan: Plan) -> Iterator[AnalysisJob]:
    """Yield all jobs that need the features of a recording."""
    analyses = plan.study.analyses
    matched = {name: level.meets for name, level in plan.study.noise.levels.items() if level.meets}
    recordings = {settings.recording for settings in (*matched.values(), *analyses.comparison.values())}
    recordings |= {name for selection in analyses.pca.values() for name in selection.recordings}
    for name in sorted(recordings):
        yield _job("recorded_features", recording=name)
    for name in matched:
        yield _job("matched_level", noise=name)
    if matched:
        yield _job("matched_noise")
    for name in analyses.comparison:
        yield _job("comparison", "comparison_features", "comparison_families", comparison=name)
        yield _job("figure_comparison", comparison=name)
