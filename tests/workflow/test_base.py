"""The study that a configuration changes, and start angles, in dry runs."""

import os
import sys
from pathlib import Path

import pytest
import yaml
from snakemake.api import SnakemakeApi
from snakemake.logging import logger
from snakemake.settings.types import ConfigSettings, OutputSettings, ResourceSettings
from workflow_runs import ROOT, planned, snakemake, tiny

DEFAULT, PAPER_GROUPS = "config/config.yaml", "config/paper_groups.yaml"
TABLES = {DEFAULT: "features/group_2/mgy10/seed00.csv", PAPER_GROUPS: "features/fbp_150/dose10/seed00.csv"}


@pytest.mark.parametrize("base", TABLES)
@pytest.mark.parametrize("given", ["itself", "in an overlay"])
def test_base_is_the_study_that_a_configuration_changes(base, given, tmp_path):
    (tmp_path / "my.yaml").write_text(yaml.safe_dump({"base": base}))
    file = {"itself": base, "in an overlay": tmp_path / "my.yaml"}[given]
    results = {DEFAULT: "results", PAPER_GROUPS: "results-paper-groups"}[base]
    jobs = planned(snakemake(f"{results}/{TABLES[base]}", "-n", "--forceall", "--configfile", file))
    assert [rule for rule in jobs if rule.startswith("extract")]
    other = TABLES[PAPER_GROUPS if base == DEFAULT else DEFAULT]
    process = snakemake(f"{results}/{other}", "-n", "--configfile", file)
    assert process.returncode == 1 and other.split("/")[1] in process.stdout + process.stderr


def test_study_without_a_configuration_is_the_default_one():
    jobs = planned(snakemake(f"results/{TABLES[DEFAULT]}", "-n", "--forceall"))
    assert [rule for rule in jobs if rule.startswith("extract")]


@pytest.mark.parametrize("file", [None, PAPER_GROUPS, "config/tiny.yaml"])
def test_index_page_shows_the_given_configuration_but_not_its_base(file, monkeypatch):
    monkeypatch.chdir(ROOT)
    # The Snakefile changes the path of modules, the environment and the logger.
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setattr(logger, "handlers", [*logger.handlers])
    settings = {
        "config_settings": ConfigSettings(configfiles=[Path(file)] if file else []),
        "resource_settings": ResourceSettings(cores=1),
    }
    with SnakemakeApi(OutputSettings()) as api:
        workflow = api.workflow(**settings, snakefile=ROOT / "workflow" / "Snakefile")._workflow
        context = workflow.globals["context"]
    *_, again = context.pages.commands().values()
    assert again == "snakemake --cores 2" + (f" --configfile {file}" if file else "")


@pytest.mark.parametrize("base", ["config/tiny.yaml", 3])
def test_unknown_base_is_one_line(base, tmp_path):
    (tmp_path / "my.yaml").write_text(yaml.safe_dump({"base": base}))
    process = snakemake("-n", "--configfile", tmp_path / "my.yaml")
    output = process.stdout + process.stderr
    assert process.returncode == 1 and "Traceback" not in output
    (line,) = [line for line in output.splitlines() if line.startswith("Error: ")]
    assert line.startswith("Error: config: base"), line


@pytest.mark.parametrize("start_angle", ["fixed", "random"])
def test_each_repeat_with_a_start_angle_has_a_projection_job(start_angle, tmp_path):
    folder = tmp_path / "r"
    tables = [folder / "features" / "fbp_150" / "dose10" / f"seed0{seed}.csv" for seed in range(3)]
    jobs = planned(tiny(folder, *tables, "-n", overlay={"repeats": {"start_angle": start_angle}}))
    scans = [f"clean_angle0{seed}" for seed in range(3)] if start_angle == "random" else ["clean"]
    assert sorted(jobs["project"]) == [f"geometry=views150, scan={scan}" for scan in scans]
