"""The table of outputs lists exactly the files of the rules, each with its rule."""

import re
from pathlib import PurePosixPath

import pytest
import yaml
from test_workflow import IMPORTED, recorded
from workflow_runs import snakemake

from virtual_phantom.config.outputs import OUTPUTS, WILDCARD
from virtual_phantom.study.progress.time_left import stage_of

ALL = ("report_page", "viewer", "dicom", "plan", "recordings", "alignment", "diagnosis", "next_measurement")
ALL += ("image_quality",)


def made(process):
    """{(kind of rule, file)} of a dry run."""
    assert process.returncode == 0, process.stderr[-2000:]
    files, rule = set(), None
    for line in map(str.strip, process.stdout.splitlines()):
        if match := re.fullmatch(r"(?:local)?rule (\w+):", line):
            rule = re.sub(r"^(reconstruct|extract)_.*", r"\1", match[1])
        elif line.startswith("output: "):
            files |= {(rule, file) for file in line.removeprefix("output: ").split(", ")}
    return files


def pattern(output, suffix):
    """Pattern that its files match."""
    parts = WILDCARD.split(output.pattern)
    words = [re.escape(part) if place % 2 == 0 else ".+" for place, part in enumerate(parts)]
    return re.compile("".join(words) + re.escape(suffix))


PATTERNS = [(output, suffix, pattern(output, suffix)) for output in OUTPUTS for suffix in output.suffixes]


@pytest.fixture(scope="module")
def planned_files(tmp_path_factory):
    """Files of several studies:

    the default one, the blind test, with recordings of every kind, and of a scanned phantom.
    """
    folder = tmp_path_factory.mktemp("outputs")
    overlay = {"results_dir": "r", "keep_projections": True}
    overlay["analyses"] = {"stability": {"noise_control": True}}
    names = {name: kind for kinds in IMPORTED.values() for name, kind in kinds.items()} | {"scanner": "images"}
    names["other_disc"] = "projections"
    overlay["recordings"] = {name: str(recorded(folder / name, kind)) for name, kind in names.items()}
    discs = {name: {"disc": {"diameter_mm": 70, "material": "pmma"}} for name in ("solid_disc", "other_disc")}
    overlay["diagnosis"] = {"recordings": discs, "scanners": {"bench": {"recordings": list(discs)}}}
    overlay["image_quality"] = {"scanned": {"recordings": ["scanner"]}}
    (folder / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    settings = ("--configfile", "config/recordings.yaml", folder / "overlay.yaml")
    with_recordings = made(snakemake("all", *ALL, "-n", "--forceall", *settings))
    scanned = made(
        snakemake("all", "-n", "--forceall", "--configfile", "config/printed_phantom.yaml", "--config", "results_dir=r")
    )
    moved = {"results_dir": "r", "repeats": {"repositioned": 1, "shift_mm": 1.0}, "physics": {"scatter": None}}
    moved["analyses"] = {"stability": {"without_physics": True}, "extraction": {"bin_width": [10]}}
    (folder / "moved.yaml").write_text(yaml.safe_dump(moved))
    voxels = made(snakemake("all", "-n", "--forceall", "--configfile", folder / "moved.yaml"))
    alone = made(snakemake("all", "proof", "hide", "score", "-n", "--forceall", "--config", "results_dir=r"))
    return {
        (rule, str(PurePosixPath(file).relative_to("r"))) for rule, file in with_recordings | alone | scanned | voxels
    }


def test_every_file_of_a_rule_is_in_the_table(planned_files):
    assert len(planned_files) > 700
    for rule, file in planned_files:
        rules = {one.rule for one, _, files in PATTERNS if files.fullmatch(file)}
        assert rule in rules, (rule, file, rules)


def test_every_row_of_the_table_is_made_by_its_rule(planned_files):
    for one, suffix, files in PATTERNS:
        found = [file for rule, file in planned_files if rule == one.rule and files.fullmatch(file)]
        # Sinograms are fetched if there is a network (test_download.py).
        assert found or one.rule == "download_htc2022", (one.name, suffix)


def test_rows_distinguish_files():
    assert len({output.name for output in OUTPUTS}) == len(OUTPUTS)
    assert len({(output.rule, output.pattern) for output in OUTPUTS}) == len(OUTPUTS)
    assert all(stage_of(output.rule) in (output.rule, "figures") for output in OUTPUTS)
