"""Functions of `import virtual_phantom` give the results of the workflow."""

import inspect
from pathlib import Path

import numpy as np
import pytest
import yaml
from recording_folders import SCAN, projections_folder, write_projections
from simulated_scans import noisy_lines

import virtual_phantom as vp
from virtual_phantom.api import simulated
from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.io.files import read_csv
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.reading import load_recording

CONFIG = Path(__file__).resolve().parents[2] / "config"


def section(name, key):
    return yaml.safe_load((CONFIG / name).read_text())[key]


def test_defaults_are_those_of_the_papers_groups():
    grid, scan, noise = (section("paper_groups.yaml", key) for key in ("grid", "scan", "noise"))
    assert list(simulated.SHAPE) == grid["shape"] and list(simulated.SPACING_MM) == grid["spacing_mm"]
    assert simulated.STUDY["scan"].items() <= scan.items()
    assert noise["levels"]["dose10"]["A"] == simulated.NOISE_LEVEL
    assert simulated.PROJECTIONS in {one["projections"] for one in section("paper_groups.yaml", "protocols").values()}
    default_arguments = inspect.signature(vp.draw_phantom).parameters
    assert default_arguments["oversampling"].default == grid["oversampling"]


@pytest.fixture(scope="module")
def phantom():
    grid = section("tiny.yaml", "grid")
    return vp.draw_phantom(grid["shape"], grid["spacing_mm"])


def scanned(phantom, repeats):
    level = section("tiny.yaml", "noise")["levels"]["dose10"]
    return vp.scan(phantom, projections=150, noise_level=level["A"], repeats=repeats, **section("tiny.yaml", "scan"))


@pytest.mark.filterwarnings("ignore::virtual_phantom.features.extraction.RadiomicsWarning")
def test_features_equal_those_of_the_study(study, phantom):
    """Bit for bit: the same streams, and tables keep every digit."""
    found = vp.extract(vp.reconstruct(scanned(phantom, 2), "fbp"), phantom)
    made = read_csv(study / "features.csv").query("protocol == 'fbp_150' and noise == 'dose10' and seed < 2")
    np.testing.assert_array_equal(found[list(FEATURES)], made[list(FEATURES)])
    assert list(found["roi"]) == list(made["roi"]) and list(found["image"]) == list(made["seed"])
    assert list(found["tissue_class"]) == list(made["tissue_class"])


def test_images_by_sirt_equal_those_of_the_study(study, phantom):
    """Up to rounding to integer HU: the study reconstructs more realizations at once, whose sums round differently."""
    (image,) = vp.reconstruct(scanned(phantom, 1), "sirt", **section("tiny.yaml", "reconstruction")["sirt"])
    made = read_nifti(study / "images" / "sirt_150" / "dose10" / "seed00.nii.gz").array
    difference = np.abs(image.array.astype(int) - made)
    assert difference.max() <= 1 and (difference > 0).mean() < 0.01


def test_effects_act_on_the_scan_and_on_its_images(phantom):
    scanner = section("tiny.yaml", "scan")
    plain = vp.scan(phantom, projections=60, **scanner)
    changed = vp.scan(
        phantom, projections=60, physics={"scatter": {"amount": 0.2}, "hu_calibration": {"offset_hu": 30}}, **scanner
    )
    assert set(changed.image_physics) == {"hu_calibration"}
    assert changed.clean.max() < plain.clean.max() - 0.1  # scatter adds signal in the shadow
    same = vp.scan(phantom, projections=60, physics={"hu_calibration": {"offset_hu": 30, "scale": 1.0}}, **scanner)
    (before,), (after,) = vp.reconstruct(plain), vp.reconstruct(same)
    np.testing.assert_allclose(after.array - before.array.astype(float), 30, atol=1)


def test_recording_is_diagnosed(tmp_path):
    folder, content = projections_folder(tmp_path / "bench", log=True)
    chain = Chain(DiscScene(120.0, "water"), load_recording(folder).geometry, photons=1e5, samples=2)
    lines = noisy_lines(chain.state({"scatter": {"amount": 0.3, "width_mm": 40.0}}), 3, np.random.default_rng(3))
    for name, one in zip("abc", lines.astype(np.float32), strict=True):
        write_projections(folder / f"{name}.h5", log=True, data=one)
    found = vp.diagnose(folder, disc=(120.0, "water"), effects=["scatter", "electronic_noise"]).content
    assert [effect["name"] for effect in found["effects"]] == ["scatter"], found["sentence"]
    assert found["excess_removed"] > 0.9 and SCAN["views"] == content["scan"]["views"]
    assert found["setup"]["kind"] == "as stated" and "start angle" in found["setup"]["alike"]
    other = vp.diagnose(folder, disc=(95.0, "Water"))
    assert other.choice is None and other.content["verdict"] == "another object"
    assert other.content["verdict_lines"][0] == (
        "Wrong object: the scan does not show a cylinder along z, 95 mm across, of water."
    )


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda one: vp.scan(one, column=7), "scan: unknown key 'column' in scan; did you mean"),
        (lambda one: vp.scan(one, physics={"scater": {}}), "scater"),
        (lambda one: vp.scan(one, projections=20, columns=20), "ROI normal_1"),
        (lambda one: vp.reconstruct(None, "sirrt"), "algorithm 'sirrt' is unknown; did you mean"),
        (lambda one: vp.reconstruct(None, "sirt", iteration=3), "sirt: unknown key 'iteration' in sirt; did you mean"),
        (lambda one: vp.extract(vp.draw_phantom((12, 40, 40), (8.0, 7.5, 7.5)).image, one), "is on another grid"),
        (
            lambda one: vp.diagnose("nowhere"),
            "0 of disc, mask, labels, shapes, phantom, scan, simulation and unknown are given",
        ),
        (lambda one: vp.diagnose("nowhere", disc=(70.0, "water")), "nowhere"),
    ],
)
def test_bad_input_is_one_clear_line(phantom, call, message):
    with pytest.raises(InputError) as caught:
        call(phantom)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_public_names_are_found_and_others_are_not():
    assert {"draw_phantom", "read_phantom", "scan", "reconstruct", "extract", "diagnose"} <= set(dir(vp))
    for name in ("draw_phantom", "read_phantom", "scan", "reconstruct", "extract", "diagnose"):
        assert inspect.getdoc(getattr(vp, name))
    with pytest.raises(AttributeError, match="no attribute 'phantoms'"):
        _ = vp.phantoms
