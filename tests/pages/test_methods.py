"""The text for the methods section has the numbers of the study's configuration and the installed versions."""

import copy
import re
from importlib import metadata

import pytest
from resolved import resolved

from virtual_phantom import __version__
from virtual_phantom.report.methods import how_to_report
from virtual_phantom.report.study import packages

CHANGES = {  # path of a setting: (changed value, its text, text that the change removes)
    "seed": (77, "random seed 77", "random seed 2022"),
    "phantom.source": ("ct", "CT scans of a CT image on", "synthetic"),
    "grid.shape": ([7, 8, 9], "on 7 × 8 × 9 voxels", "76 × 152 × 210"),
    "grid.spacing_mm": ([3.5, 2.5, 1.5], "voxels of 3.5 × 2.5 × 1.5 mm (z, y, x)", "voxels of 1 × 1.4 × 1.4 mm"),
    "scan.trajectory": ("circular", "Scan: circular, source", "pitch"),
    "scan.pitch": (0.8, "helical with pitch 0.8", "pitch 1,"),
    "scan.beam": ("parallel", "parallel beam", "source-to-isocenter"),
    "scan.source_to_isocentre_mm": (541, "source-to-isocenter distance 541 mm", "distance 595 mm"),
    "scan.source_to_detector_mm": (949, "source-to-detector distance 949 mm", "distance 1085.6 mm"),
    "scan.rows": (16, "detector of 16 × 450 pixels", "64 × 450"),
    "scan.column_pitch_mm": (1.1, "of 1.0947 × 1.1 mm", "1.0947 × 1.2858 mm"),
    "noise.levels.mgy10.A": (2e-5, "mgy10 (50000 photons per pixel and view without an object, 10 repeats)", "44600"),
    "noise.levels.mgy1.repeats": (
        9,
        "mgy1 (10850 photons per pixel and view without an object, 9 repeats)",
        "mgy1 (10850 photons per pixel and view without an object, 5",
    ),
    "repeats.shift_mm": (2.5, "re-positioned by up to 2.5 mm", "1.5 mm and"),
    "repeats.repositioned": (0, "44600 photons", "re-positioned"),
    "protocols.group_1.projections": (
        1234,
        "group_1 (1234 projections, kernel",
        "all with 2980 projections",
    ),
    "protocols.group_7.voxels.thickness_mm": (4.5, "slice thickness 4.5 mm", "no such text"),
    "protocols.whole_fbp.algorithm": ("sirt", "whole_fbp (500 iterations of SIRT", "and filtered back-projection):"),
    "protocols.group_7.kernel.mtf50_per_cm": (
        3.21,
        "group_7 (kernel with MTF50 3.21/cm",
        "group_7 (kernel with MTF50 3.1/cm",
    ),
    "physics.from": ("bench", "Simulated physical effects: the effects of the diagnosis of bench.", "No physical"),
    "physics": ({"scatter": {"amount": 0.04}}, "Simulated physical effects: scatter (amount = 0.04).", "No physical"),
    "features.section": ("whole", "each ROI (3D)", "largest slice"),
    "features.stored_offset_hu": (0, "no resampling.", "added to HU"),
    "features.parameters": ("my.yaml", "with the settings of my.yaml", "bin width"),
    "statistics.threshold": (1.96, "|W| < 1.96", "|W| < 1 "),
    "statistics.compare": ("tissue_class", "repeats of one tissue class", "repeats of one ROI"),
    "analyses.stability.noise": ("mgy3", "at noise level mgy3", "at noise level mgy10"),
    "analyses.stability.cut_offs.w_stability_percent": (60, "at least 60 % were called stable", "50 %"),
    "analyses.stability.cut_offs.icc": (0.9, "over ROIs) was at least 0.9 for", "at least 0.75"),
    "analyses.stability": (None, "Software", "rank-sum"),
}


def report(config):
    return how_to_report(config, packages(), __version__)


@pytest.mark.parametrize("path", CHANGES)
def test_every_number_comes_from_the_configuration(path):
    before = resolved("config.yaml")
    value, stated, replaced = CHANGES[path]
    after = copy.deepcopy(before)
    *parents, name = path.split(".")
    inside = after
    for key in parents:
        inside = inside[key]
    inside[name] = value
    text = report(after)
    assert stated in text and replaced not in text
    assert path in ("features.stored_offset_hu", "repeats.repositioned") or stated not in report(before) or not value
    assert replaced in report(before) or replaced == "no such text"


def test_effects_of_the_study_and_of_protocols_are_named_once():
    plain = {"algorithm": "fbp", "projections": 500, "group": 1}
    protocols = {"plain": plain, "other": plain | {"group": 2, "physics": {"source_drift": {}}}}
    changes = {"protocols": protocols, "physics": {"scatter": {"amount": 0.04}}, "analyses": {}}
    text = report(resolved("config.yaml", **changes))
    sentence = next(part for part in text.split(". ") if part.startswith("Simulated physical effects"))
    assert sentence.count("scatter") == 1 and "source_drift (in some protocols)" in sentence


def test_single_protocol_has_no_stability_between_protocols():
    config = resolved("config.yaml")
    for name, protocol in config["protocols"].items():
        protocol["group"] = 1 if name == "group_1" else None
    assert "called robust" in report(config) and "rank-sum" not in report(config)


def test_versions_are_those_installed():
    text = report(resolved("config.yaml"))
    assert f"Virtual Phantom {__version__}" in text and f"pyradiomics {metadata.version('pyradiomics')}" in text
    assert f"numpy {metadata.version('numpy')}" in text and "\n" not in text


@pytest.mark.parametrize("name", ["tiny.yaml", "paper_groups.yaml", "config.yaml"])
def test_every_protocol_is_named_once(name):
    config = resolved(name)
    protocols = report(config).partition("Protocols")[2]
    assert all(len(re.findall(rf"\b{name}\b", protocols)) == 1 for name in config["protocols"])
