"""Every tutorial, followed to the letter in a copy of the project that holds the results of the tiny study."""

import json
import shutil

import pytest
from pages import copy_project, follow, run
from workflow_runs import ROOT

REAL = ROOT / "../shared/real"
GIVEN = {  # real measurements that a tutorial begins with, where its reader has them
    "clinical-ct": ("abdomen_ct", "resources/abdomen_ct"),
    "own-sinogram": ("htc2022/htc2022_solid_disc_full.mat", "htc2022_solid_disc_full.mat"),
}
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
    if page.stem in GIVEN:
        source, place = GIVEN[page.stem]
        if not (REAL / source).exists():
            pytest.skip(f"needs {source} among the real measurements")
        (folder / place).parent.mkdir(exist_ok=True)
        (folder / place).symlink_to((REAL / source).resolve())
    follow(page, folder)
    if page.stem in FOUND:
        FOUND[page.stem](folder)


def scatter_is_found(folder):
    found = json.loads((folder / "results-bench" / "diagnosis" / "bench" / "diagnosis.json").read_text())
    (effect,) = found["effects"]
    amount = effect["parameters"]["amount"]
    assert (found["verdict"], effect["name"]) == ("mismatch explained", "scatter")
    numbers = (amount["value"], *amount["ci95"], *amount["ci95_noise"])
    assert [f"{number:.3g}" for number in numbers] == ["0.0495", "0.0461", "0.0529", "0.0486", "0.0505"]
    assert found["excess_removed"] > 0.995


def spectrum_and_dark_signal_are_missing(folder):
    found = json.loads((folder / "results" / "diagnosis" / "solid_disc" / "diagnosis.json").read_text())
    assert [effect["name"] for effect in found["effects"]] == ["spectrum", "dark_signal"]
    assert found["verdict"] == "mismatch partly explained"


# What a tutorial says of a page that a person reads.
FOUND = {"read-a-diagnosis": scatter_is_found, "own-sinogram": spectrum_and_dark_signal_are_missing}
