"""The time limit of cluster jobs grows with the work, has a minimum, and agrees with docs/how-to/cluster.md."""

import copy
from pathlib import Path

import pytest
import yaml
from snakemake.utils import update_config
from test_config import DEFAULT

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.study.costs.jobs import Job, Sizes, study_jobs
from virtual_phantom.study.costs.limits import FLOOR_MINUTES, SAFETY, UNKNOWN_MINUTES, minutes
from virtual_phantom.study.costs.rates import read_rates, seconds

ROOT = Path(__file__).resolve().parents[1]
RATES = read_rates(RESOURCES / "rates.yaml")
# Large enough to be far above the minimum.
PAPER = yaml.safe_load((ROOT / "config" / "paper.yaml").read_text())
ON_CPU = {"reconstruction": {"sirt": {"backprojector": "adjoint"}}}

# {(configuration, engine)}: minutes of the shortest and the longest job of each stage.
STAGES = ("phantom", "project", "reconstruct_sirt", "reconstruct_fbp", "merge_features", "noise_calibration")
SHORTEST = dict.fromkeys(STAGES, (10, 10)) | {"extract": (30, 30)}
LARGE = SHORTEST | {"reconstruct_fbp": (10, 12)}
LIMITS = {
    **{(name, "cpu"): SHORTEST for name in ("tiny", "paper_groups", "large", "abdomen")},
    ("config", "cpu"): {stage: limits for stage, limits in SHORTEST.items() if stage != "reconstruct_sirt"},
    ("recordings", "cpu"): SHORTEST | {"reconstruct_sirt": (10, 13)},
    ("paper", "cpu"): LARGE | {"reconstruct_sirt": (92, 302)},
    ("paper", "astra_cuda"): LARGE | {"reconstruct_sirt": (41, 140)},
}


def plan_of(*overlays):
    """Default study with overlays on top."""
    config = copy.deepcopy(DEFAULT)
    for overlay in overlays:
        update_config(config, copy.deepcopy(overlay))
    return Plan(read_study(config))


def sizes(*overlays, engine="cpu"):
    return Sizes(plan_of(*overlays), engine)


def minutes_of(name, engine="cpu"):
    """{stage: minutes of its shortest and longest jobs} for config/<name>.yaml."""
    lines, config = read_configs([ROOT / "config" / f"{name}.yaml"])
    assert not lines
    found = {}
    for job in study_jobs(Plan(read_study(config)), engine, rois=1):
        found.setdefault(job.stage, set()).add(minutes(RATES, job.stage, job.work))
    return {stage: (min(values), max(values)) for stage, values in found.items()}


@pytest.mark.parametrize(
    "overlay",
    [
        {"grid": {"shape": [192, 512, 512], "spacing_mm": [0.5, 0.6, 0.6]}},
        {"grid": {"shape": [96, 768, 768], "spacing_mm": [1.0, 0.4, 0.4]}},
        {"scan": {"rows": 1024, "row_pitch_mm": 0.5}},
        {"scan": {"columns": 1280, "column_pitch_mm": 0.5}},
        {"protocols": {"sirt_150": {"projections": 300}, "fbp_150": {"projections": 300}}},
        {"reconstruction": {"sirt": {"tolerance_hu": 0}}},
        {"reconstruction": {"sirt": {"solver": "plain"}}},
    ],
)
def test_larger_jobs_get_more_time(overlay):
    before, after = sizes(PAPER, ON_CPU), sizes(PAPER, ON_CPU, overlay)
    sirt = [minutes(RATES, *one.reconstruction(["sirt_150"], 16)) for one in (before, after)]
    assert FLOOR_MINUTES < sirt[0] < sirt[1]
    fbp = [minutes(RATES, *one.reconstruction(["fbp_450"], 64)) for one in (before, after)]
    grown = after.voxels > before.voxels
    # Noise and filters take time per ray, in FBP much less than the back-projection.
    more_rays = after.rays(after.plan.geometry_of("fbp_450")) > before.rays(before.plan.geometry_of("fbp_450"))
    assert FLOOR_MINUTES < fbp[0] < fbp[1] if grown else fbp[0] == fbp[1] or (more_rays and fbp[0] < fbp[1])
    geometries = [one.plan.geometry_of("sirt_150") for one in (before, after)]
    steps = [one.rays(name) * one.across for one, name in zip((before, after), geometries, strict=True)]
    # A hundred times the work, which takes more than the minimum.
    works = [one.projection(name)[1] for one, name in zip((before, after), geometries, strict=True)]
    projection = [minutes(RATES, "project", {unit: 100 * work[unit] for unit in work}) for work in works]
    assert projection[0] < projection[1] if steps[0] < steps[1] else projection[0] == projection[1]


def test_more_realizations_get_more_time():
    paper = sizes(PAPER, ON_CPU)
    images = [minutes(RATES, *paper.reconstruction(["sirt_450"], lanes)) for lanes in (1, 8, 16, 17, 64)]
    assert images == sorted(set(images))
    # One more realization than fits into a pass of the projector takes another pass.
    assert images[3] > 1.8 * images[2]
    for stage in ("extract", "merge_features", "noise_calibration"):
        few, many = (minutes(RATES, stage, paper.images(count)) for count in (10, 100_000))
        assert few < many, stage


def test_small_jobs_get_the_minimum_and_others_a_multiple():
    small, large = sizes(), sizes(PAPER, ON_CPU)
    assert minutes(RATES, *small.reconstruction(["sirt_450"], 16)) == FLOOR_MINUTES
    stage, work = large.reconstruction(["sirt_450"], 10)
    measured = seconds(Job("reconstruct", stage, (), work), RATES) / 60
    assert SAFETY * measured <= minutes(RATES, stage, work) < SAFETY * measured + 1


def test_uncertain_stages_get_larger_multiples():
    """Eight times as much for slower GPUs, and 27 times for all effects; more than the minimum without a rate."""
    physics = sizes({"noise": {"model": "physical"}, "physics": {"spectrum": {"kvp": 120, "filtration_mm": 6}}})
    plain = sizes()
    with_effects, without = (one.projection(one.plan.geometry_of("sirt_450")) for one in (physics, plain))
    assert with_effects[0] == "project_physics" and without[0] == "project"
    assert minutes({"seconds": {}}, *without) == UNKNOWN_MINUTES
    gpu = sizes(PAPER, engine="astra_cuda").reconstruction(["sirt_300"], 10)
    for (stage, work), factor in ((gpu, 8), (with_effects, 27)):
        many = {unit: 100 * amount for unit, amount in work.items()}
        measured = seconds(Job("reconstruct", stage, (), many), RATES) / 60
        assert minutes(RATES, stage, many) == pytest.approx(factor * SAFETY * measured, abs=1)
    stage, work = with_effects
    assert minutes(RATES, stage, work) > minutes(RATES, *without)


def test_limits_follow_the_rates():
    stage, work = sizes(PAPER, ON_CPU).reconstruction(["sirt_450"], 10)
    user_rates = {"seconds": RATES["seconds"] | {stage: {"ray_step_lane": 60 / work["ray_step_lane"]}}}
    assert minutes(user_rates, stage, work) == FLOOR_MINUTES
    user_rates["seconds"][stage]["job"] = 3540.0
    assert minutes(user_rates, stage, work) == SAFETY * 60


@pytest.mark.parametrize(("name", "engine"), LIMITS)
def test_shipped_configurations_have_these_limits(name, engine):
    found = {}
    for stage, limits in minutes_of(name, engine).items():
        # One entry for SIRT, for all back-projectors and engines.
        found["reconstruct_sirt" if stage.startswith("reconstruct_sirt") else stage] = limits
    assert {stage: found[stage] for stage in LIMITS[name, engine]} == LIMITS[name, engine]


def test_documentation_quotes_the_longest_limits():
    text = " ".join((ROOT / "docs" / "how-to" / "cluster.md").read_text().split())
    cpu, gpu = ("{} to {}".format(*LIMITS["paper", engine]["reconstruct_sirt"]) for engine in ("cpu", "astra_cuda"))
    assert f"{cpu} minutes on CPUs and {gpu} on GPUs" in text
