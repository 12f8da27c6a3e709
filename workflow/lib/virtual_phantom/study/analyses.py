"""Jobs after the features: statistics, figures, and what holds a study against recordings."""

from __future__ import annotations

from collections.abc import Iterator

from .plan import Plan

AnalysisJob = tuple[str, str, tuple[str, ...], int]


def jobs(plan: Plan) -> Iterator[AnalysisJob]:
    """(rule, stage, files in results_dir, images read) of every job that follows the features or stands beside them.

    What reads recordings is of stage "recordings": how large they are is not in the configuration.
    """
    yield _figure("rois")
    analyses = plan.config["analyses"]
    if featured := plan.featured():
        yield (
            "merge_features",
            "merge_features",
            ("features.csv",),
            sum(len(plan.seeds(noise)) for _, noise in featured),
        )
    if "optimal" in analyses:
        yield _figure("scans")
    if "noise_calibration" in analyses:
        calibration = analyses["noise_calibration"]
        images = len(calibration["protocols"]) * sum(len(plan.seeds(noise)) for noise in calibration["noise"])
        yield "noise_calibration", "noise_calibration", ("tables/noise_calibration.csv",), images
        yield _figure("noise_calibration")
    if "stability" in analyses:
        yield from _stability(plan)
    for name in analyses.get("pca", {}):
        yield "pca", "tables", (f"tables/pca_{name}.csv", f"tables/separability_{name}.csv"), 0
        yield _figure(f"pca_{name}")
    found = list(_compared(plan))
    yield from found
    if featured or "noise_calibration" in analyses or found:
        yield "parquet", "parquet", ("features.parquet",), 0


def _figure(name, rule=None, stage="figures") -> AnalysisJob:
    return f"figure_{rule or name}", stage, (f"figures/{name}.png", f"figures/{name}.pdf"), 0


def _table(rule, name, stage="tables") -> AnalysisJob:
    return rule, stage, (f"tables/{name}.csv",), 0


def _stability(plan):
    yield _table("stability", "stability")
    tables = ("tables/stability_measures.csv", "tables/stable_features.csv")
    yield "stability_measures", "tables", tables, 0
    yield _table("top_features", "top_features")
    yield _figure("stability_discrimination")
    if plan.config["measured"]["overlay"]:
        yield _table("overlap", "overlap")
        yield _figure("overlap")
    for name in plan.config["analyses"]["stability"]["recordings"]:
        yield "recording_scores", "recordings", (f"recordings/{name}/scores.csv",), 0
        yield _table("overlap_recording", f"overlap_{name}", "recordings")
        yield _figure(f"overlap_{name}", "overlap_recording", "recordings")


def _compared(plan):
    """Everything that needs a recording's features."""
    config = plan.config
    analyses = config["analyses"]
    matched = {name: level["meets"] for name, level in config["noise"]["levels"].items() if "meets" in level}
    compared = analyses.get("comparison", {})
    read = {one["recording"] for one in (*matched.values(), *compared.values())}
    read |= {name for selection in analyses.get("pca", {}).values() for name in selection["recordings"]}
    for name in sorted(read):
        yield "recording_features", "recordings", (f"recordings/{name}/features.csv",), 0
    for name in matched:
        yield "match_noise", "recordings", (f"noise/{name}.json",), 0
    if matched:
        yield _table("matched_noise", "matched_noise", "recordings")
    for name, comparison in compared.items():
        tables = tuple(f"tables/comparison_{name}{part}.csv" for part in ("", "_features", "_families"))
        yield "compare", "recordings", tables, 0
        yield _figure(f"comparison_{name}", "comparison", "recordings")
        if comparison["attribute"]:
            images = len(plan.seeds(comparison["noise"]))
            tables = tuple(f"tables/attribution_{name}{part}.csv" for part in ("", "_cells"))
            yield "attribute", "recordings", tables, images
            yield _figure(f"attribution_{name}", "attribution", "recordings")
