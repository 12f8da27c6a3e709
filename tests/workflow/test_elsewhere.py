"""The workflow in a folder that contains only a configuration."""

import itertools
import re
import shutil
import subprocess

import pytest
import warm
import yaml
from workflow_runs import ROOT, planned

SNAKEFILES = (ROOT / "Snakefile", ROOT / "workflow" / "Snakefile")
MODULE = """
configfile: "config/paper_groups.yaml"


module virtual_phantom:
    snakefile:
        "{snakefile}"
    config:
        config


use rule * from virtual_phantom{names}


onstart:
    virtual_phantom.onstart()
"""
TABLE = "results-tiny/features/fbp_150/dose10/seed00.csv"


def snakemake(folder, *words, cwd=None):
    """Snakemake on the tiny study, without PYTHONPATH."""
    command = [warm.python(), "-m", "snakemake", "--cores", "2", *map(str, words)]
    command += ["--configfile", str(folder / "config" / "tiny.yaml")]
    return subprocess.run(command, cwd=cwd or folder, capture_output=True, text=True, timeout=600)


def jobs_of(process):
    """{rule: [wildcards], sorted} of a dry run; `all` is called `default` in the Snakefile at the root."""
    return {re.sub(r"(?<![a-z])default$", "all", rule): sorted(jobs) for rule, jobs in planned(process).items()}


@pytest.fixture
def folder(tmp_path):
    """Two files of the configuration, the second with an eighth of the voxels and a quarter of the pixels."""
    place = tmp_path / "study"
    (place / "config").mkdir(parents=True)
    shutil.copy(ROOT / "config" / "paper_groups.yaml", place / "config")
    content = yaml.safe_load((ROOT / "config" / "tiny.yaml").read_text())
    content["grid"] = {"shape": [12, 40, 40], "spacing_mm": [8.0, 7.5, 7.5]}
    content["scan"] |= {"columns": 50, "rows": 15, "column_pitch_mm": 12.8, "row_pitch_mm": 12.8}
    (place / "config" / "tiny.yaml").write_text(yaml.safe_dump(content))
    return place


@pytest.mark.parametrize("first, second", [SNAKEFILES, SNAKEFILES[::-1]], ids=["root", "workflow"])
def test_run_by_directory_continues_as_a_module(folder, tmp_path, first, second):
    """Both find the same files with the same inputs: the second has nothing to do."""
    process = snakemake(folder, TABLE, "-s", first, "--directory", folder, cwd=tmp_path)
    assert process.returncode == 0 and (folder / TABLE).stat().st_size > 1000, process.stderr[-3000:]
    made = (folder / TABLE).read_bytes()

    (folder / "Snakefile").write_text(MODULE.format(names="", snakefile=second))
    assert "Nothing to be done" in snakemake(folder, TABLE).stderr
    other = TABLE.replace("150", "300")
    process = snakemake(folder, other)
    output = process.stdout + process.stderr
    assert process.returncode == 0 and (folder / other).exists(), output[-3000:]
    # Lines of Virtual Phantom instead of Snakemake's, as in the project's own folder.
    assert re.search(r"^[\d:]+ (\d+) of \1 jobs done", output, re.MULTILINE) and "rule extract" not in output
    assert (folder / TABLE).read_bytes() == made
    assert sorted(path.name for path in folder.iterdir()) == [".snakemake", "Snakefile", "config", "results-tiny"]


def test_whole_study_is_planned_as_in_the_project(folder, tmp_path):
    """With its own rule names and with others; local rules stay local with both.

    The profile is found wherever the workflow is named. It omits the host's name from the output, and the files of a
    job from its rerun triggers.
    """

    def dry(*words, cwd=None):
        return snakemake(folder, "-n", "-p", *words, cwd=cwd)

    here = None
    for words in ((), ("-s", "Snakefile"), ("-s", "workflow/Snakefile"), ("-s", ROOT / "Snakefile")):
        process = dry(*words, cwd=ROOT)
        here = here or jobs_of(process)
        assert jobs_of(process) == here and len(here) > 20
        assert "profiles/default for setting default command line arguments" in process.stderr
    for snakefile in SNAKEFILES:
        assert jobs_of(dry("-s", snakefile, "--directory", folder, cwd=tmp_path)) == here
    for names, snakefile in itertools.product(("", " as phantom_*"), SNAKEFILES):
        (folder / "Snakefile").write_text(MODULE.format(names=names, snakefile=snakefile))
        process = dry()
        renamed = {names.removeprefix(" as ").replace("*", rule) or rule: jobs for rule, jobs in here.items()}
        assert jobs_of(process) == renamed
        assert "localrules directive" not in process.stderr
