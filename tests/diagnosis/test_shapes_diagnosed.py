"""Diagnosis of a recording whose object consists of shapes, read from its folder."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import yaml
from simulated_scans import noisy_lines

import virtual_phantom as vp
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular, parallel_beam
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.assumptions import object_text
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanned_object import scene_of
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.shapes import ShapesScene
from virtual_phantom.recordings.importers.study import scan_section

GEOMETRY = circular(
    views=24,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=44,
    rows=4,
    column_pitch_mm=10.0,
    row_pitch_mm=8.0,
)
SECTION = {"samples": 1, "view_step": 1, "alignment": {}, "object": {"kind": "acr464_module1"}}
ASKED = DiagnosisRequest("nowhere", from_mapping(RecordingSettings, SECTION), 0.0193, Segmentation())


FINELY = 3  # rays per pixel and direction of the scan


def recorded(folder, physics, photons=2e5, geometry=GEOMETRY, larger_mm=0.0):
    """Four repeats of the ACR module, written as a recording."""
    chain = Chain(body(larger_mm), geometry, photons=photons, samples=FINELY)
    lines = noisy_lines(chain.state(checked(physics)), 4, np.random.default_rng(3))
    names = [f"{number}.h5" for number in range(4)]
    for name, one in zip(names, lines, strict=True):
        with h5py.File(folder / name, "w") as file:
            data = file.create_dataset("exchange/data", data=one.astype(np.float32))
            data.attrs["log"] = True
            file["exchange/theta"] = np.rad2deg(geometry.angles_rad)
    content = {"name": "bench", "kind": "projections", "scan": scan_section(geometry), "repeats": names}
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    return folder


def body(by_mm):
    """The ACR module with a larger body."""
    scene = scene_of(ASKED)
    return scene.grown([by_mm, *[0.0] * (len(scene.shapes) - 1)])


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("bench"), {"scatter": {"amount": 0.06}})


def test_missing_effect_is_named(bench):
    found = vp.diagnose(
        bench, shapes="acr464_module1", samples=1, effects=["scatter", "optical_crosstalk"], check_setup=False
    )
    assert [effect["name"] for effect in found.content["effects"]] == ["scatter"], found.content["sentence"]
    low, high = found.content["effects"][0]["parameters"]["amount"]["ci95"]
    assert low - (high - low) / 2 < 0.06 < high + (high - low) / 2


def test_parallel_beam_is_read_and_diagnosed(tmp_path):
    """Half a turn; the set-up is checked first, and no effect of a focal spot is a candidate."""
    geometry = circular(
        views=24, turns=0.5, columns=44, rows=4, column_pitch_mm=5.5, row_pitch_mm=4.4, **parallel_beam()
    )
    folder = recorded(tmp_path, {"dark_signal": {"level_units": 2000.0, "drift_units_per_s": 0.0}}, geometry=geometry)
    assert "source_to_isocentre_mm" not in (folder / "recording.yaml").read_text()
    tried = ["dark_signal", "electronic_noise", "detector_roll"]
    found = vp.diagnose(folder, shapes="acr464_module1", samples=1, effects=tried)
    assert [effect["name"] for effect in found.content["effects"]] == ["dark_signal"], found.content["sentence"]
    assert found.content["setup"]["kind"] == "as stated", found.content["setup"]
    with pytest.raises(InputError, match="focal_spot needs a focal spot"):
        vp.diagnose(folder, shapes="acr464_module1", samples=1, effects=["focal_spot"])


@pytest.mark.parametrize("divided", [False, True])
def test_undersampled_edges_are_not_reported_as_physics(divided, tmp_path, monkeypatch):
    """The module alone, seen by a realistic detector. Without divided pixels at edges, effects would be shown."""
    scan = recorded(tmp_path, {}, photons=2e6)
    if not divided:
        monkeypatch.setattr(ShapesScene, "edge_scans", lambda *_: ())
    tried = ["source_distance", "off_focal_radiation", "view_blur", "focal_spot"]
    found = vp.diagnose(scan, shapes="acr464_module1", effects=tried, check_setup=False).content
    assert (found["verdict"] == "match") == divided, found["sentence"]


def test_errors_of_surfaces_are_those_of_the_fitted_geometry(tmp_path):
    """The stated distance of the source is 4 mm too large: edges are seen elsewhere."""
    declared = {"isocentre_mm": {"value": 0.0, "sd": 4.0}, "detector_mm": {"value": 0.0, "sd": 0.0}}
    scan = recorded(tmp_path, {"source_distance": {"isocentre_mm": -4.0}})
    settings = from_mapping(RecordingSettings, SECTION | {"samples": 2, "baseline": {"source_distance": declared}})
    model = prepare_recording(DiagnosisRequest(scan, settings, 0.0193, Segmentation()))[1].fitter.model
    distance_mm = 570.0 + model.first.physics["source_distance"]["isocentre_mm"]
    outer = next(name for name in model.object_errors.names if name.startswith("surface_of_"))
    fitted_mm, step_mm = model.first.nuisance[outer], 1e-3
    assert (distance_mm, fitted_mm) == (pytest.approx(566, abs=0.2), pytest.approx(0, abs=0.02))
    smaller, larger = (
        Chain(body(by_mm), replace(GEOMETRY, source_to_isocentre_mm=distance_mm), samples=FINELY).state({})
        for by_mm in (fitted_mm - step_mm, fitted_mm + step_mm)
    )
    change = (larger.line_integrals() - smaller.line_integrals()) / step_mm / 2
    found = model.object_errors.changes[model.object_errors.names.index(outer)]
    assert np.linalg.norm(found - change) < 0.03 * np.linalg.norm(change)  # 11 % in the stated geometry


def test_source_distance_is_fitted_beside_a_wrong_surface(tmp_path):
    """Errors of surfaces are linearized at the fitted distances. Where a fit without effects puts them, errors of the
    distances are 0.6 and 2.8 mm."""
    true = {"isocentre_mm": 12.0, "detector_mm": 4.0}
    scan = recorded(tmp_path, {"source_distance": true}, photons=1e6, larger_mm=-0.3)
    found = vp.diagnose(scan, shapes="acr464_module1", samples=2, effects=["source_distance"], check_setup=False)
    (effect,) = found.content["effects"]
    fitted = {name: parameter["value"] for name, parameter in effect["parameters"].items()}
    assert fitted["isocentre_mm"] == pytest.approx(12.0, abs=0.2) and fitted["detector_mm"] == pytest.approx(4, abs=0.8)


def test_modeled_object_is_described():
    assert object_text(ASKED).startswith("shapes (acr464_module1): ACR CT accreditation phantom")


def test_images_are_compared_in_its_regions():
    scanned = ScannedVolume.of_shapes(read_object("acr464_module1"), GEOMETRY, 0.0193)
    assert scanned.rois.keys() == {"polyethylene", "bone", "acrylic", "water"}
    assert scanned.fine.array[scanned.rois["acrylic"]].mean() == pytest.approx(117, abs=5)
    assert scanned.radius_mm == pytest.approx(100, abs=4)
