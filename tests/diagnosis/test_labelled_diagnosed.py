"""Diagnosis of a recording whose object is a label map of two materials, and the report on its voxels."""

import numpy as np
import pytest
from drawn_objects import CYLINDERS, ENERGY_KEV, GEOMETRY, MATERIALS, MU_WATER_PER_MM, SPECTRUM, bench, drawn

import virtual_phantom as vp
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.assumptions import object_text
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanned_object import scene_of
from virtual_phantom.diagnosis.settings import LabelledObject, RecordingSettings
from virtual_phantom.physics.beam.materials import Segmentation, attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.labeled import read_label_map
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder


def of_voxels(found):
    return [line for line in found.content["caveats"] if "edges" in line]


def test_missing_spectrum_is_named(tmp_path):
    """No single material could replace it: the additional attenuation by aluminum depends on the spectrum."""
    folder = bench(tmp_path, {"spectrum": SPECTRUM})
    path = drawn(tmp_path / "labels.nii.gz", 0.4)
    found = vp.diagnose(folder, labels=(path, MATERIALS), samples=2, effects=["spectrum", "scatter"], check_setup=False)
    (effect,) = found.content["effects"]
    assert effect["name"] == "spectrum", found.content["sentence"]
    assert found.content["excess_removed"] > 0.99
    assert effect["parameters"]["kvp"]["value"] == pytest.approx(100, rel=0.05)


def test_correct_object_passes_the_check_and_another_fails(tmp_path):
    """Also if a spectrum is missing."""
    folder = bench(tmp_path, {"spectrum": SPECTRUM})
    path = drawn(tmp_path / "labels.nii.gz", 1.0)
    found = vp.diagnose(folder, labels=(path, MATERIALS), samples=1, effects=["scatter"])
    assert found.content["setup"]["kind"] == "as stated"
    other = vp.diagnose(folder, labels=(path, {1: "polyethylene", 2: "nothing"}), samples=1, effects=["scatter"])
    assert other.content["verdict"] == "another object"
    assert "the scan does not show the label map labels.nii.gz, of polyethylene" in other.content["sentence"]


def test_mismatch_at_edges_of_voxels_is_reported(tmp_path):
    folder = bench(tmp_path, {})
    path = drawn(tmp_path / "labels.nii.gz", 1.0)
    known = dict(samples=2, effects=["scatter"], check_setup=False, object_exact=True)
    found = vp.diagnose(folder, labels=(path, MATERIALS), **known)
    assert of_voxels(found) == [
        "The remaining mismatch lies along edges, as caused by the voxels of labels.nii.gz (1 mm); finer voxels or an "
        "object of shapes would show whether anything else remains (docs/how-to/objects.md)."
    ]


def test_mask_without_fractional_voxels_is_reported_at_edges(tmp_path):
    folder = bench(tmp_path, {}, CYLINDERS[:1])
    known = dict(samples=2, effects=["scatter"], check_setup=False, alignment={"scale": 1.0}, object_exact=True)
    whole = vp.diagnose(folder, mask=(drawn(tmp_path / "whole.nii.gz", 1.0, 1), "pmma"), **known)
    (line,) = of_voxels(whole)
    assert "whole.nii.gz (1 mm); finer voxels, shares of voxels (0 to 1) or an object of shapes" in line
    shares = vp.diagnose(folder, mask=(drawn(tmp_path / "shares.nii.gz", 1.0, 8), "pmma"), **known)
    assert not of_voxels(shares)
    after = [one.content["held_out"]["chi_square_mean"]["after"] for one in (whole, shares)]
    assert after[1] - 1 < 0.5 * (after[0] - 1)  # beyond noise


def test_mismatch_in_all_rays_is_not_attributed_to_voxels(tmp_path):
    folder = bench(tmp_path, {"scatter": {"amount": 0.1}})
    path = drawn(tmp_path / "labels.nii.gz", 0.5)
    known = dict(samples=2, effects=["focal_spot"], check_setup=False, object_exact=True)
    found = vp.diagnose(folder, labels=(path, MATERIALS), **known)
    assert "edges" in [place["domain"] for place in found.content["unexplained"]]
    assert not of_voxels(found)


def test_modeled_object_is_described():
    settings = {"samples": 1, "view_step": 1, "alignment": {}}
    materials = {"1": "pmma", "2": {"compound": "C2F4", "density_g_per_cm3": 2.16}, "3": "nothing", "4": "pmma"}
    given = {"object": {"labels": "maps/rods.nii.gz", "materials": materials}}
    asked = DiagnosisRequest(
        "nowhere", from_mapping(RecordingSettings, settings | given), MU_WATER_PER_MM, Segmentation()
    )
    assert isinstance(asked.settings.object, LabelledObject)
    assert object_text(asked) == "the label map rods.nii.gz, of pmma and C2F4 (2.16 g/cm3)"


def test_beam_without_effects_equals_that_of_shapes(tmp_path):
    """At the energy where water has the declared attenuation; only there has the map its line integrals."""
    path = drawn(tmp_path / "labels.nii.gz", 0.2)
    given = {"object": {"labels": str(path), "materials": {str(key): of for key, of in MATERIALS.items()}}}
    settings = from_mapping(RecordingSettings, {"samples": 1, "view_step": 1, "alignment": {}} | given)
    scene = scene_of(DiagnosisRequest("nowhere", settings, MU_WATER_PER_MM, Segmentation()))
    shapes = ShapesScene([cylinder(*one) for one in CYLINDERS], ENERGY_KEV)
    found, expected = (Chain(one, GEOMETRY).state({}).line_integrals() for one in (scene, shapes))
    assert np.abs(found - expected).mean() < 0.005 * expected.max()


def test_images_are_compared_in_hu_of_its_materials(tmp_path):
    path = drawn(tmp_path / "labels.nii.gz", 0.5)
    scanned = ScannedVolume.of_labels(read_label_map(path, {"1": "water", "2": "aluminium"}), MU_WATER_PER_MM)
    labels = np.unique(scanned.fine.array)
    aluminium = attenuation_per_mm("aluminium", [ENERGY_KEV])[0]
    np.testing.assert_allclose(labels, [-1000, 0, 1000 * (aluminium / MU_WATER_PER_MM - 1)], atol=0.5)
    assert scanned.fine.grid.shape[0] == 2 and scanned.radius_mm == pytest.approx(35, abs=0.5)


def test_scanned_object_is_described_once(tmp_path):
    with pytest.raises(InputError, match="2 of disc, mask, labels, shapes, phantom, scan, simulation and unknown"):
        vp.diagnose(tmp_path, labels=("labels.nii.gz", MATERIALS), shapes="pmma_disc")
