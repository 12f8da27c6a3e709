"""`snakemake plan`: its job counts equal those of a dry run, and rules state what a cluster needs."""

import json
import re
from collections import Counter

import pandas as pd
import pytest
import yaml
from test_limits import RATES, plan_of
from test_workflow import recorded
from workflow_runs import ROOT, snakemake, tiny

from virtual_phantom.study.costs.jobs import study_jobs
from virtual_phantom.study.costs.limits import minutes


def kinds(process):
    """{kind of rule: jobs} of a dry run's table, without its total."""
    assert process.returncode == 0, process.stderr[-2000:]
    table = dict(re.findall(r"^(\w+) +(\d+)$", process.stdout, re.MULTILINE))
    found = Counter()
    for rule, jobs in table.items():
        if rule not in ("all", "default", "total"):
            found[re.sub(r"^(reconstruct|extract)_.*", r"\1", rule)] += int(jobs)
    return found


def profile():
    """Settings of the SLURM profile."""
    return yaml.safe_load((ROOT / "workflow" / "profiles" / "slurm" / "config.yaml").read_text())


@pytest.mark.parametrize("config", ["config", "recordings"])
def test_job_counts_equal_those_of_a_dry_run(config, tmp_path):
    overlay = {"results_dir": f"{tmp_path}/r", "keep_projections": config == "config"}
    if config == "recordings":
        overlay["recordings"] = {name: str(recorded(tmp_path / name, "features")) for name in ("tandem", "dose_series")}
    (tmp_path / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    files = [f"config/{config}.yaml", tmp_path / "overlay.yaml"]
    process = snakemake("plan", "--configfile", *files)
    assert process.returncode == 0, process.stderr[-2000:]
    table = pd.read_csv(tmp_path / "r" / "plan.csv")
    counted = dict(table.groupby("rule")["jobs"].sum())
    # With the groups of a cluster, none of which may wait for itself: matched noise waits for images and vice versa.
    groups = ["--group-components", *(f"{entry.split('=')[0]}=1000" for entry in profile()["group-components"])]
    assert counted == kinds(snakemake("-n", "-q", "rules", "--configfile", *files, *groups))
    content = json.loads((tmp_path / "r" / "plan.json").read_text())
    assert content["jobs"] == table["jobs"].sum()
    # Printed again even if there is nothing to do.
    again = [snakemake("plan", "--configfile", *files)] if config == "config" else []
    for once in (process, *again):
        assert f"{content['acquisitions']} acquisitions, {content['jobs']} jobs" in once.stdout


def test_temporary_images_are_removed_after_use(tmp_path):
    results = tmp_path / "r"
    overlay = {"keep_images": False, "grid": {"shape": [12, 40, 40], "spacing_mm": [8.0, 7.5, 7.5]}}
    table = results / "features" / "fbp_150" / "dose10" / "seed01.csv"
    process = tiny(results, table, overlay=overlay)
    assert process.returncode == 0, process.stderr[-3000:]
    assert len(pd.read_csv(table)) == 6
    assert not list((results / "images").rglob("*.nii.gz"))
    again = tiny(results, table, overlay=overlay)
    assert "Nothing to be done" in again.stdout + again.stderr


def rules_of(path):
    """{rule: its text} of a file of rules; numbered rules share one text."""
    parts = re.split(r"^ *rule ?(\w*):$", path.read_text(), flags=re.MULTILINE)
    return {name or f"{path.stem}, numbered": text for name, text in zip(parts[1::2], parts[2::2], strict=True)}


def test_every_rule_that_is_not_local_states_its_resources():
    """Memory and time, without which a cluster gives every job the same. A GPU is requested with a number."""
    local, gpu_rules = set(), 0
    paths = sorted((ROOT / "workflow" / "rules").glob("*.smk"))
    for path in paths:
        for rule, text in rules_of(path).items():
            if "localrule: True" in text:
                local.add(rule)
                continue
            resources = re.search(r"^ +resources:\n((?: {8}.*\n)+?)(?= {4}(?: {4})?[a-z_]+:|\Z)", text, re.MULTILINE)
            assert resources, f"{path.name}: {rule} has no resources"
            for key in ("mem_mb", "runtime"):
                assert f"{key}=" in resources[1], f"{path.name}: {rule}: {key}"
            gpu_rules += 1
    assert gpu_rules >= 40 and {"plan", "proof_seal", "recordings"} <= local


def test_rules_request_the_time_of_their_work(tmp_path):
    """At the paper's scale, where it differs from rule to rule."""
    process = snakemake("-n", "--configfile", "config/paper.yaml", "--config", "engine=cpu", f"results_dir={tmp_path}")
    blocks = re.findall(r"^ +output: (.*)\n(?:.*\n)*? +resources: .*runtime=(\d+)", process.stdout, re.MULTILINE)
    minutes_by_file = {file: int(runtime) for files, runtime in blocks for file in files.split(", ")}
    plan = plan_of(yaml.safe_load((ROOT / "config" / "paper.yaml").read_text()))
    counted = Counter()
    for job in study_jobs(plan, "cpu", rois=1):
        if job.rule in ("phantom", "project", "reconstruct", "extract", "merge_features", "noise_calibration"):
            counted[job.rule] += 1
            for file in job.outputs:
                assert minutes_by_file[f"{tmp_path}/{file}"] == minutes(RATES, job.stage, job.work), (job.rule, file)
    assert len(counted) == 6 and len(set(minutes_by_file.values())) > 10


def test_groups_of_the_profile_are_those_of_the_rules():
    """Groups of acquisitions depend on their noise: tests/study/test_context.py."""
    text = "".join(path.read_text() for path in (ROOT / "workflow" / "rules").glob("*.smk"))
    stated = set(re.findall(r'^ +group:\n +"(\w+)"', text, re.MULTILINE)) | {"acquisitions", "matched_acquisitions"}
    assert {entry.split("=")[0] for entry in profile()["group-components"]} <= stated
