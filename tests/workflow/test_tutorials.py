"""Every tutorial, followed to the letter in a copy of the project that holds the results of the tiny study."""

import shutil

import pytest
from pages import copy_project, follow, run
from workflow_runs import ROOT

CT = ROOT / "../shared/real/abdomen_ct"
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))


@pytest.fixture(scope="module")
def finished(study, tmp_path_factory):
    """A copy of the project in which the tiny study has been run, as Snakemake remembers it."""
    folder = tmp_path_factory.mktemp("tutorials") / "finished"
    copy_project(ROOT, folder)
    shutil.copytree(study, folder / "results-tiny")
    # What was asked for elsewhere is unknown here: touching everything writes it down.
    run("snakemake --touch --forceall --cores 2 --configfile config/tiny.yaml", folder)
    return folder


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_what_a_tutorial_says_is_what_happens(page, finished, tmp_path):
    folder = tmp_path / "project"
    shutil.copytree(finished, folder)
    if page.stem == "clinical-ct":
        if not CT.exists():
            pytest.skip("needs abdomen_ct among the real measurements")
        (folder / "downloads").mkdir()
        (folder / "downloads" / "abdomen_ct").symlink_to(CT.resolve())
    follow(page, folder)
