"""`snakemake plan`: the jobs that it counts are those of a dry run, and its rules say what a cluster has to know."""

import json
import re
from collections import Counter

import pandas as pd
import pytest
import yaml
from test_workflow import recorded
from workflow_runs import snakemake, tiny


def kinds(process):
    """{kind of rule: jobs} of a dry run's table, without what it counts for itself."""
    assert process.returncode == 0, process.stderr[-2000:]
    table = dict(re.findall(r"^(\w+) +(\d+)$", process.stdout, re.MULTILINE))
    found = Counter()
    for rule, jobs in table.items():
        if rule not in ("all", "total"):
            found[re.sub(r"^(reconstruct|extract)_.*", r"\1", rule)] += int(jobs)
    return found


@pytest.mark.parametrize("config", ["config", "recordings"])
def test_the_jobs_counted_are_those_of_a_dry_run(config, tmp_path):
    overlay = {"results_dir": f"{tmp_path}/r", "keep_projections": config == "config"}
    if config == "recordings":
        overlay["recordings"] = {name: str(recorded(tmp_path / name, "features")) for name in ("tandem", "dose_series")}
    (tmp_path / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    files = [f"config/{config}.yaml", tmp_path / "overlay.yaml"]
    process = snakemake("plan", "--configfile", *files)
    assert process.returncode == 0, process.stderr[-2000:]
    table = pd.read_csv(tmp_path / "r" / "plan.csv")
    counted = dict(table.groupby("rule")["jobs"].sum())
    assert counted == kinds(snakemake("-n", "-q", "rules", "--configfile", *files))
    content = json.loads((tmp_path / "r" / "plan.json").read_text())
    assert content["jobs"] == table["jobs"].sum()
    # Printed too, and again when there is nothing to be done.
    again = [snakemake("plan", "--configfile", *files)] if config == "config" else []
    for once in (process, *again):
        assert f"{content['acquisitions']} acquisitions, {content['jobs']} jobs" in once.stdout


def test_images_that_are_not_kept_are_gone_once_used(tmp_path):
    results, overlay = tmp_path / "r", {"keep_images": False}
    table = results / "features" / "fbp_150" / "dose10" / "seed01.csv"
    process = tiny(results, table, overlay=overlay)
    assert process.returncode == 0, process.stderr[-3000:]
    assert len(pd.read_csv(table)) == 6
    assert not list((results / "images").rglob("*.nii.gz"))
    again = tiny(results, table, overlay=overlay)
    assert "Nothing to be done" in again.stdout + again.stderr
