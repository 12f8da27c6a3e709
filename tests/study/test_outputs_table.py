"""The table of outputs. tests/workflow/test_outputs.py compares the rules with it."""

from pathlib import Path

import pytest

from virtual_phantom.config.outputs import BY_NAME, Files, by_path

ROOT = Path(__file__).resolve().parents[2]


def test_unknown_parts_remain_wildcards():
    files = Files("a {b}/results")
    assert files("image", noise="low") == "a {b}/results/images/{protocol}/low/seed{seed}.nii.gz"
    assert files("image", protocol="p", noise="low", seed="07") == "a {b}/results/images/p/low/seed07.nii.gz"
    assert files("figure_rois", ".pdf") == "a {b}/results/figures/rois.pdf"
    assert files.benchmark("project/g") == "a {b}/results/logs/project/g.benchmark.tsv"


@pytest.mark.parametrize("name, suffix", [("figure_rois", ""), ("image", ".png"), ("imag", "")])
def test_file_missing_in_the_table_is_rejected(name, suffix):
    with pytest.raises(KeyError):
        Files("r")(name, suffix)


def test_path_leads_to_its_row():
    assert by_path("images/{protocol}/{noise}/seed{seed}.nii.gz") is BY_NAME["image"]
    assert by_path("figures/overlap_{recording}.png") is BY_NAME["figure_overlap_recording"]
    with pytest.raises(KeyError, match="figures/overlaps.png: no row"):
        by_path("figures/overlaps.png")


def test_caption_has_the_name_of_its_file_or_of_the_table():
    assert BY_NAME["figure_scans"].caption_file() == "scans.rst"
    assert BY_NAME["stable_features"].caption_file() == "stability_measures.rst"
    for output in BY_NAME.values():
        if output.section:
            assert (ROOT / "workflow" / "report" / output.caption_file()).exists(), output.name
