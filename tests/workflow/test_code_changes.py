"""A change of code runs jobs again; a change of text does not."""

import pytest
from pages import copy_project
from workflow_runs import ROOT, snakemake

TARGET = "results-tiny/phantom/positions.csv"
TINY = ("--configfile", "config/tiny.yaml")
POSE = "workflow/lib/virtual_phantom/base/pose.py"  # imported by the script and by one of its imports
NOTHING = "Nothing to be done"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A copy of the project in which one job was run."""
    folder = tmp_path_factory.mktemp("project") / "copy"
    copy_project(ROOT, folder)
    environment = {"PYTHONPATH": ""}
    process = snakemake(TARGET, *TINY, project=folder, environment=environment)
    assert process.returncode == 0, process.stderr[-2000:]
    return folder


def dry(project, *words):
    process = snakemake(TARGET, "-n", *words, *TINY, project=project, environment={"PYTHONPATH": ""})
    assert process.returncode == 0, process.stderr[-2000:]
    return process.stdout + process.stderr


def change(project, old, new, path=POSE):
    text = (project / path).read_text()
    assert old in text
    (project / path).write_text(text.replace(old, new, 1))


def test_changed_text_runs_nothing(project):
    assert NOTHING in dry(project)
    change(project, '"""', '"""Other words. ')
    change(project, "def main", "# A comment.\ndef main", "workflow/scripts/positions.py")
    assert NOTHING in dry(project)


def test_changed_code_runs_again_unless_touched(project):
    with (project / POSE).open("a") as file:
        file.write("\nADDED = 1\n")
    output = dry(project)
    assert "rule positions" in output and "Params have changed" in output
    assert "positions.csv" in dry(project, "--summary")
    process = snakemake(TARGET, "--touch", *TINY, project=project, environment={"PYTHONPATH": ""})
    assert process.returncode == 0, process.stderr[-2000:]
    assert NOTHING in dry(project)
    change(project, "ADDED = 1", "ADDED = 2")
    assert "rule positions" in dry(project)
    process = snakemake(TARGET, *TINY, project=project, environment={"PYTHONPATH": ""})
    assert process.returncode == 0, process.stderr[-2000:]
    assert NOTHING in dry(project)


def test_code_of_other_scripts_runs_nothing(project):
    before = dry(project)
    with (project / "workflow/lib/virtual_phantom/statistics/wilcoxon.py").open("a") as file:
        file.write("\nADDED = 1\n")
    assert dry(project) == before
