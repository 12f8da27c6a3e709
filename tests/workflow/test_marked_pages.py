"""Follow every page of docs with marked blocks in a copy of the project with results of the tiny study."""

import json
import shutil

import pytest
from pages import blocks, copy_project, follow, marked, run, share_kernels
from workflow_runs import ROOT

DOCS, REAL = ROOT / "docs", ROOT / "../shared/real"
GIVEN = {  # page: real measurements that its reader has, and their path
    "getting-started/clinical-ct.md": ("abdomen_ct", "resources/abdomen_ct"),
    "getting-started/own-sinogram.md": ("htc2022/htc2022_solid_disc_full.mat", "htc2022_solid_disc_full.mat"),
}
BEFORE = {"getting-started/own-simulation.md": ("how-to/diagnosis.md", "make_scans.py")}  # page: script of another page


@pytest.fixture(scope="module")
def finished(study, tmp_path_factory):
    """A copy of the project with a completed tiny study in Snakemake's records."""
    folder = tmp_path_factory.mktemp("pages") / "finished"
    copy_project(ROOT, folder)
    share_kernels(ROOT, folder)
    shutil.copytree(study, folder / "results-tiny")
    # Snakemake does not know these results yet: touching everything records them.
    run("snakemake --touch --forceall --cores 2 --configfile config/tiny.yaml", folder)
    return folder


@pytest.mark.parametrize("page", marked(DOCS), ids=lambda page: page.stem)
def test_page_has_its_stated_results(page, finished, tmp_path):
    name, folder = page.relative_to(DOCS).as_posix(), tmp_path / "project"
    shutil.copytree(finished, folder, symlinks=True)
    if name in GIVEN:
        source, path = GIVEN[name]
        if not (REAL / source).exists():
            pytest.skip(f"needs {source} among the real measurements")
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).symlink_to((REAL / source).resolve())
    if name in BEFORE:
        other, script = BEFORE[name]
        (text,) = (block.text for block in blocks(DOCS / other) if (block.kind, block.file) == ("write", script))
        (folder / script).write_text(text)
        run(f"python {script}", folder)
    follow(page, folder)
    if name in FOUND:
        FOUND[name](folder)


def check_scatter_is_found(folder):
    found = json.loads((folder / "results-bench" / "diagnosis" / "bench" / "diagnosis.json").read_text())
    (effect,) = found["effects"]
    amount = effect["parameters"]["amount"]
    assert (found["verdict"], effect["name"]) == ("mismatch explained", "scatter")
    numbers = (amount["value"], *amount["ci95"], *amount["ci95_noise"])
    assert [f"{number:.3g}" for number in numbers] == ["0.0501", "0.0475", "0.0527", "0.0496", "0.0507"]
    assert found["excess_removed"] > 0.995


def check_spectrum_and_dark_signal_are_missing(folder):
    found = json.loads((folder / "results" / "diagnosis" / "solid_disc" / "diagnosis.json").read_text())
    assert [effect["name"] for effect in found["effects"]] == ["spectrum", "dark_signal"]
    assert found["verdict"] == "mismatch partly explained"


# Page: check of its statements about a report.
FOUND = {
    "how-to/diagnosis.md": check_scatter_is_found,
    "getting-started/own-sinogram.md": check_spectrum_and_dark_signal_are_missing,
}


@pytest.mark.parametrize("page", sorted({*GIVEN, *FOUND}))
def test_pages_with_a_check_are_marked(page):
    assert DOCS / page in marked(DOCS)
