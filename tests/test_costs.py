"""Estimated costs of a study, compared with a completed study, and with known rates and sizes."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import yaml
from test_config import DEFAULT, changed

from benchmarks.fit_rates import fit
from benchmarks.sirt_rates import CASES, sized
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.study.costs.jobs import Job, Sizes, study_jobs
from virtual_phantom.study.costs.rates import read_rates, seconds, written_bytes
from virtual_phantom.study.costs.table import cost_summary

ROOT = Path(__file__).resolve().parents[1]
RATES = RESOURCES / "rates.yaml"


def jobs_of(config, engine="cpu"):
    plan = Plan(read_study(config))
    return study_jobs(plan, engine, len(plan.tissue_classes))


def totals(jobs, stage):
    """Work of all jobs of a stage."""
    found = defaultdict(float)
    for job in jobs:
        if job.stage == stage:
            for unit, amount in job.work.items():
                found[unit] += amount
    return found


def test_study_of_the_papers_groups_has_its_measured_cost():
    """Each stage within a quarter of its measured seconds, all stages within a tenth.

    Noisy projections are excluded: they were measured on ten files that the study does not make.
    """
    rates = read_rates(RATES)
    measured = {stage: took for stage, took in rates["measured"]["seconds"].items() if stage != "acquire"}
    estimated = defaultdict(float)
    for job in jobs_of(changed("reconstruction", {"sirt": {"terms": 60, "tolerance_hu": 0}})):  # as it was measured
        estimated[job.stage] += seconds(job, rates)
    assert estimated.keys() == measured.keys()
    for stage, took in measured.items():
        assert estimated[stage] == pytest.approx(took, rel=0.25), stage
    assert sum(estimated.values()) == pytest.approx(sum(measured.values()), rel=0.1)


def test_study_of_the_papers_groups_writes_its_measured_size():
    rates = read_rates(RATES)
    _, content = cost_summary(Plan(read_study(DEFAULT)), "cpu", rates)
    for kind, sizes in content["bytes"].items():
        # Logs were counted with those of the noisy projections.
        assert sizes["total"] == pytest.approx(rates["measured"]["bytes"][kind], rel=0.15), kind
    assert content["acquisitions"] == 252
    assert content["bytes_kept"] == content["bytes_written"]


@pytest.mark.parametrize(
    "key, value, stage, unit, times",
    [
        ("grid.shape", [96, 256, 256], "reconstruct_sirt", "ray_step_lane", 2),
        ("grid.shape", [96, 256, 256], "reconstruct_fbp", "image_voxel_view", 8),
        ("grid.oversampling", 4, "phantom", "fine_voxel", 8),
        ("scan.rows", 96, "project", "ray_step", 2),
        ("scan.columns", 320, "reconstruct_sirt", "ray_step", 2),
        ("reconstruction", {"sirt": {"terms": 30}}, "reconstruct_sirt", "ray_step", 31 / 54),
        ("reconstruction", {"sirt": {"solver": "plain"}}, "reconstruct_sirt", "ray_step", 501 / 54),
        ("reconstruction", {"sirt": {"iterations": 20}}, "reconstruct_sirt", "ray_step", 12 / 54),
        ("reconstruction", {"sirt": {"iterations": 20}}, "reconstruct_sirt", "image_voxel_term", 12 / 54),
        ("protocols.sirt_450.projections", 1350, "reconstruct_fbp", "image_voxel_view", 1),
        ("seeds_per_job", 8, "reconstruct_sirt", "ray_step_lane", 1),
    ],
)
def test_work_grows_with_the_sizes(key, value, stage, unit, times):
    before, after = (totals(jobs_of(config), stage)[unit] for config in (DEFAULT, changed(key, value)))
    assert after / before == pytest.approx(times)


def test_large_study_is_one():
    config = yaml.safe_load((ROOT / "config" / "large.yaml").read_text())
    levels = DEFAULT["noise"]["levels"]
    merged = {name: level | config["noise"]["levels"][name] for name, level in levels.items()}
    _, content = cost_summary(Plan(read_study(changed("noise.levels", merged))), "cpu", read_rates(RATES))
    assert content["acquisitions"] >= 1000


def test_more_repeats_are_more_images_and_jobs():
    config = changed("noise.levels.dose10.repeats", 20)
    before, after = (totals(jobs_of(one), "extract") for one in (DEFAULT, config))
    # Sixteen repeats fit into a job. The other four need one more in eight of ten protocols; in sirt_200 and sirt_250
    # they share the job of another level.
    assert after["job"] - before["job"] == 8
    assert (after["image_voxel"] - before["image_voxel"]) / (48 * 128 * 128) == 100


def test_every_stage_has_a_rate_and_a_plan_without_one_fails():
    """All engines, back-projectors and effects; the error names the stage and the number of its jobs."""
    config = changed("reconstruction", {"sirt": {"backprojector": "voxel"}})
    rates = read_rates(RATES)
    for engine, stage in (("cpu", "reconstruct_sirt_voxel"), ("astra_cuda", "reconstruct_sirt_astra_cuda")):
        table, content = cost_summary(Plan(read_study(config)), engine, rates)
        assert table.set_index("stage")["jobs"][stage] == 14
        assert content["core_hours"] == pytest.approx(table["core_hours"].sum())
    config["noise"]["model"] = "physical"
    config["physics"] = {"scatter": {}}
    table, _ = cost_summary(Plan(read_study(config)), "cpu", rates)
    assert table.set_index("stage")["core_hours"]["project_physics"] > 0
    del rates["seconds"]["project_physics"]
    with pytest.raises(InputError, match=r"no rate was measured for project_physics \(5 jobs\)"):
        cost_summary(Plan(read_study(config)), "cpu", rates)


@pytest.mark.parametrize("name, projections, took", [("config", 2980, 11.6), ("paper", 60, 3.98)])
def test_projections_have_their_measured_cost(name, projections, took):
    """CPU time of jobs of the default study (median of 12), and of config/paper.yaml with 60 views."""
    lines, config = read_configs([ROOT / "config" / f"{name}.yaml"])
    assert not lines
    if name == "paper":
        config = config | {"grid": config["grid"] | {"oversampling": 1}}
        config["protocols"] = {"sirt_150": config["protocols"]["sirt_150"] | {"projections": projections}}
        config["analyses"] = {}
    sizes = Sizes(Plan(read_study(config)), "cpu")
    stage, work = sizes.projection(f"views{projections}")
    assert seconds(Job("project", stage, (), work), read_rates(RATES)) == pytest.approx(took, rel=0.25)


def test_voxel_driven_sirt_has_its_measured_cost():
    """Jobs at the scale of config/paper.yaml and at half of it, within a quarter of their measured times.

    benchmarks/sirt_rates.py measured all but the last. That is the mean CPU time of two jobs of Snakemake.
    """
    lines, config = read_configs([ROOT / "config" / "paper.yaml"])
    assert not lines
    rates, study = read_rates(RATES), read_study(config)
    cases = [*zip(CASES, rates["measured"]["sirt_voxel"]["seconds"], strict=True), ((60, 1, 60, 1, 20), 18.5)]
    for (projections, lanes, _, factor, iterations), took in cases:
        sizes = Sizes(Plan(sized(study, factor, projections, iterations)), "cpu")
        stage, work = sizes.reconstruction(["sirt_150"], lanes)
        assert seconds(Job("reconstruct", stage, (), work), rates) == pytest.approx(took, rel=0.25), (
            projections,
            factor,
        )


def test_temporary_images_count_as_written():
    rates = read_rates(RATES)
    stored, not_kept = (
        cost_summary(Plan(read_study(changed("keep_images", keep))), "cpu", rates)[1] for keep in (True, False)
    )
    assert stored["bytes_written"] == not_kept["bytes_written"]
    assert stored["bytes_kept"] - not_kept["bytes_kept"] == stored["bytes"]["images"]["total"]


def test_stored_projections_are_one_file_per_scan():
    """Protocols that differ only in the reconstruction share their noisy projections."""
    jobs = jobs_of(changed("keep_projections", True))
    files = [job.outputs[0] for job in jobs if job.rule == "acquire"]
    assert len(files) == len(set(files))
    assert files.count("projections/views150/dose10/seed09.h5") == 1
    with_rate = [written_bytes(job, read_rates(RATES)) for job in jobs if job.rule == "acquire"]
    # Poisson counts of about 20 bits, compressed: between one and four bytes per pixel.
    rays = [job.work["ray"] for job in jobs if job.rule == "acquire"]
    assert all(1 < size / ray < 4 for size, ray in zip(with_rate, rays, strict=True))


def test_rates_are_recovered_from_times():
    random = np.random.default_rng(np.random.SeedSequence(4))
    work = [{"job": 1, "ray": float(ray), "image": 3.0} for ray in random.uniform(1e6, 1e7, 20)]
    jobs = [(Job("r", "scan", (), one), 1.5 + 2e-7 * one["ray"]) for one in work]
    assert fit(jobs, {"scan": ["job", "ray"]})["scan"] == pytest.approx({"job": 1.5, "ray": 2e-7})
    # With one job, all time beyond the shortest job of all is work.
    alone = (Job("t", "other", (), work[0]), 7.5)
    shortest = min(took for _, took in jobs)
    rates = fit([*jobs, alone], {"scan": ["job", "ray"], "other": ["job", "ray"]})["other"]
    assert rates == pytest.approx({"job": shortest, "ray": (7.5 - shortest) / work[0]["ray"]})
    with pytest.raises(InputError, match="2 jobs are too few"):
        fit(jobs[:2], {"scan": ["job", "ray", "image"]})


@pytest.mark.parametrize(
    "text, message",
    [
        (None, "cannot be read"),
        ("seconds: [", "is not YAML"),
        ("seconds: {project: {job: 1}}", "needs seconds"),
        ("seconds: {project: {job: -1}}\nbytes: {}", "no rate under 0"),
        ("[]", "needs seconds"),
    ],
)
def test_broken_file_of_rates_is_named(text, message, tmp_path):
    path = tmp_path / "rates.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_rates(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_regions_cut_into_parts_are_counted_separately():
    ct = {"image": "ct.nii.gz", "rois": [{"name": "a", "tissue_class": "b", "file": "m.nii.gz", "parts": 3}]}
    config = changed("phantom", {"source": "ct", "ct": ct})
    config["measured"] = {"overlay": False}
    assert len(Plan(read_study(config)).tissue_classes) == 3


def test_file_of_rates_states_its_measurement():
    measured = yaml.safe_load(RATES.read_text())["measured"]
    assert measured["voxels"] == DEFAULT["grid"]["shape"]
    assert measured["detector_rows_columns"] == [DEFAULT["scan"]["rows"], DEFAULT["scan"]["columns"]]
    assert measured["machine"] and measured["jobs"] > 70
