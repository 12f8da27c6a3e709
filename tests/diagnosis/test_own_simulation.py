"""Diagnosis against the user's own simulation: path lengths between its rays, declared physics, ASTRA beside XCIST."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_objects import CYLINDERS, ENERGY_KEV, GEOMETRY, SPECTRUM, bench
from scipy import ndimage
from skimage.measure import block_reduce

import virtual_phantom as vp
from benchmarks.common import tuning_objects
from benchmarks.common.tuning_objects import OBJECTS
from benchmarks.own_simulation import project, simulated
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical, parallel_beam
from virtual_phantom.base.pose import Pose
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.projections.own_simulation import simulated_scene
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked
from virtual_phantom.physics.scenes.sampling import displace_source
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, cylinder
from virtual_phantom.physics.scenes.simulated import SimulatedScene
from virtual_phantom.proof.hiding import generate, xcist
from virtual_phantom.proof.hiding.orbits import Orbit
from virtual_phantom.recordings.reading import load_recording

DISC = DiscScene(120.0, "water")
MU_WATER = 0.0193
DETECTOR = {"views": 240, "columns": 90, "rows": 3, "column_pitch_mm": 4.0, "row_pitch_mm": 4.0}
DISTANCES = {"source_to_isocentre_mm": 500.0, "source_to_detector_mm": 900.0}
SCANS = {
    "fan": circular(**DETECTOR, **DISTANCES),
    "curved, backwards": circular(**DETECTOR, **DISTANCES, surface="cylindrical", direction=-1, start_angle_rad=1.0),
    "short": circular(**DETECTOR, **DISTANCES, turns=0.6, column_offset_px=0.25),
    "helix": helical(**DETECTOR, **DISTANCES, volume_height_mm=30.0, turns=1.5),
    "parallel": circular(**DETECTOR | {"column_pitch_mm": 2.0}, **parallel_beam()),
}


def inner(scan):
    """Columns whose rays pass well inside the disc, nine or more columns, where splines do not see its edge."""
    across = scan.source_to_isocentre_mm * np.sin(scan.fan_angles_rad())
    return np.abs(across) < 40


def known(geometry, scan, pose):
    return SimulatedScene(DISC.path_lengths(scan, pose), scan, 60.0).path_lengths(geometry)[0]


@pytest.mark.parametrize("name", SCANS)
def test_own_rays_have_their_path_lengths(name):
    scan = SCANS[name]
    expected = DISC.path_lengths(scan, Pose(x_mm=7, y_mm=-3))[0]
    np.testing.assert_allclose(known(scan, scan, pose=Pose(x_mm=7, y_mm=-3)), expected, atol=2e-4)


@pytest.mark.parametrize("name", SCANS)
def test_other_rays_through_a_disc_have_the_closed_form(name):
    scan = SCANS[name]
    scene, inside = SimulatedScene(DISC.path_lengths(scan, Pose(x_mm=2)), scan, 60.0), inner(scan)
    moved = Pose(x_mm=0.8, y_mm=-0.5, turn_deg=0.3, size=1.004)
    turn = np.deg2rad(moved.turn_deg)
    at = {"x_mm": moved.x_mm + 2 * moved.size * np.cos(turn), "y_mm": moved.y_mm + 2 * moved.size * np.sin(turn)}
    found, expected = scene.path_lengths(scan, moved)[0], DISC.path_lengths(scan, Pose(**at, size=moved.size))[0]
    between = slice(8, -8)  # at the ends of an open scan, rays of other views do not exist
    np.testing.assert_allclose(found[between, :, inside], expected[between, :, inside], atol=0.02)
    if name != "parallel":
        spot = displace_source(scan, 0.7, 0.4, 1.0)
        found, expected = scene.path_lengths(spot)[0], DISC.path_lengths(spot, Pose(x_mm=2))[0]
        np.testing.assert_allclose(found[between, :, inside], expected[between, :, inside], atol=0.02)


def settings(**given):
    return from_mapping(RecordingSettings, {"samples": None, "view_step": None, "alignment": {}} | given)


def scene_from(folder, lines, **given):
    path = str(simulated(folder / "mine.h5", lines))
    request = DiagnosisRequest(folder, settings(simulation=path, **given), MU_WATER, Segmentation())
    return simulated_scene(request, load_recording(folder))


def exact(geometry=GEOMETRY, physics=None):
    scene = ShapesScene([cylinder(*one) for one in CYLINDERS], ENERGY_KEV)
    return Chain(scene, geometry).state(checked(physics or {})).line_integrals()


def test_declared_physics_is_applied_once(tmp_path):
    """The chain reproduces the simulation, and path lengths in a disc of water are its chords."""
    crosstalk = {"column": 0.03, "row": 0.0}
    physics = checked({"spectrum": SPECTRUM, "scatter": {"amount": 0.05}, "optical_crosstalk": crosstalk})
    declared = {name: {key: {"value": value, "sd": 0.0} for key, value in one.items()} for name, one in physics.items()}
    folder, lines = bench(tmp_path, {}), exact(physics=physics)
    scene = scene_from(folder, lines, baseline=declared)
    again = Chain(scene, GEOMETRY).state(physics).line_integrals()
    np.testing.assert_allclose(again, lines, atol=1e-4)
    water = ShapesScene([cylinder("water", (0.0, 0.0, 0.0), 35.0)], ENERGY_KEV)
    lines = Chain(water, GEOMETRY).state(physics).line_integrals()
    found = scene_from(folder, lines, baseline=declared).paths_mm[0]
    np.testing.assert_allclose(found, water.path_lengths(GEOMETRY)[0], atol=0.05)


def test_path_lengths_in_other_materials_have_their_hardening(tmp_path):
    """With path lengths in aluminum, the hardened signal is that of the object."""
    scene = ShapesScene([cylinder("water", (0.0, 0.0, 0.0), 35.0), cylinder("aluminium", (15.0, 5.0, 0.0), 6.0)], 60.0)
    water, aluminum = scene.path_lengths(GEOMETRY)
    chain, hardened = Chain(scene, GEOMETRY), checked({"spectrum": SPECTRUM})
    folder, path = bench(tmp_path, {}), str(tmp_path / "mine.h5")
    request = DiagnosisRequest(
        folder, settings(simulation=path, simulation_energy_kev=60.0), MU_WATER, Segmentation(), energy_kev=60.0
    )
    missed = {}
    for name, paths in {"water": {}, "both": {"aluminium": aluminum}}.items():
        simulated(path, chain.state({}).line_integrals(), paths)
        found = Chain(simulated_scene(request, load_recording(folder)), GEOMETRY).state(hardened).line_integrals()
        missed[name] = np.abs(found - chain.state(hardened).line_integrals()).max()
    assert missed["both"] < 2e-4 < 0.05 < missed["water"]
    simulated(path, chain.state({}).line_integrals(), {"bone": aluminum[:, :, 1:]})
    with pytest.raises(InputError, match="path_lengths_mm/bone: is not one finite length per line integral"):
        simulated_scene(request, load_recording(folder))
    simulated(path, chain.state({}).line_integrals(), {"cheese": aluminum})
    with pytest.raises(InputError, match="path_lengths_mm/cheese: is no material beside water; use"):
        simulated_scene(request, load_recording(folder))


def test_finer_pixels_are_read(tmp_path):
    finer = replace(GEOMETRY, columns=4 * GEOMETRY.columns, column_pitch_mm=GEOMETRY.column_pitch_mm / 4)
    scene = scene_from(bench(tmp_path, {}), exact(finer))
    assert scene.geometry.columns == finer.columns
    found, expected = (
        Chain(one, GEOMETRY, samples=samples).state({}).line_integrals()
        for one, samples in ((scene, 4), (ShapesScene([cylinder(*one) for one in CYLINDERS], ENERGY_KEV), 8))
    )
    assert np.abs(found - expected).mean() < 1e-3


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda folder: folder.mkdir(), "the recording holds projections; give a simulation of projections"),
        (lambda path: simulated(path, exact()[::2]), "has 24 views, but recording.yaml says scan.views 48"),
        (lambda path: simulated(path, exact()), "no object gives these line integrals with dark signal"),
    ],
)
def test_what_cannot_work_is_refused(tmp_path, change, message):
    folder = bench(tmp_path, {})
    change(folder / "mine.h5")
    declared = {"dark_signal": {"level_units": {"value": 0.3, "sd": 0.0}, "drift_units_per_s": {"value": 0, "sd": 0}}}
    with pytest.raises(InputError, match=message):
        vp.diagnose(folder, simulation=folder / "mine.h5", baseline=declared if "dark" in message else {})


def test_blur_between_views_needs_dense_views():
    given = settings(simulation="mine.h5")
    assert "view_blur" in candidates(given) and "view_blur" not in candidates(given, sparse=True)


def phantom():
    """A slice in HU: water with an insert of bone and one of air."""
    step, count = 0.8, 150
    axis = (np.arange(count) - (count - 1) / 2) * step
    x, y = np.meshgrid(axis, axis)
    share = [
        np.clip((r - np.hypot(x - a, y - b)) / step + 0.5, 0, 1) for a, b, r in ((0, 0, 50), (20, 10, 8), (-15, 5, 10))
    ]
    hu = -1000 + 1000 * (share[0] + 0.8 * share[1] - share[2])
    return Volume(np.repeat(hu[None], 8, axis=0).astype(np.float32), Grid((8, count, count), (6.0, step, step)))


def test_xcist_against_a_simulation_by_astra(tmp_path):
    fine, found = phantom(), {}
    kev = xcist.energy_of_water(MU_WATER)
    orbit = Orbit(48, 40, 4, 5.5, 5.5, 500.0, 900.0)
    scan = generate.scan_of(orbit, 1e5, 1000.0, kev, {})
    lines = project(fine, scan, MU_WATER)
    for name, hidden in {"nothing": {}, "scatter": {"scatter_scale": 4.0}}.items():
        folder = tmp_path / name
        folder.mkdir()
        of = replace(scan, settings=hidden)
        materials = tuning_objects.materials(fine, OBJECTS["quality_assurance"], kev, MU_WATER)
        taken = xcist.simulate(of, materials, 4, np.random.SeedSequence(5))
        generate.write(folder, name, orbit, of.rotation_ms, taken, MU_WATER)
        path = simulated(folder / "astra.h5", lines)
        found[name] = vp.diagnose(folder, simulation=path, effects=["scatter", "optical_crosstalk"]).content
    assert found["nothing"]["verdict"] == "match", found["nothing"]["sentence"]
    assert [effect["name"] for effect in found["scatter"]["effects"]][:1] == ["scatter"], found["scatter"]["sentence"]
    assert "path length in water" in found["scatter"]["modelled"]["limits of the simulation"]


def test_simulated_images(tmp_path):
    """A simulation agrees with noisy images of itself; images with a softer kernel differ by the kernel."""
    random, found = np.random.default_rng(3), {}
    sharp = np.repeat(block_reduce(phantom().array[0], (3, 3), np.mean)[None], 8, axis=0)
    grid = Grid(sharp.shape, (2.0, 2.4, 2.4))
    write_nifti(Volume(sharp[:1], Grid((1, *sharp.shape[1:]), grid.spacing)), tmp_path / "mine.nii.gz")
    for name, pixels in {"same": 0.0, "soft": 0.6}.items():
        (folder := tmp_path / name).mkdir()
        noise = ndimage.gaussian_filter(random.normal(size=sharp.shape), (0, 0.7, 0.7)) * 20
        image = ndimage.gaussian_filter(sharp, (0, pixels, pixels)) + noise
        write_nifti(Volume(image.astype(np.float32), grid), folder / "one.nii.gz")
        (folder / "recording.yaml").write_text("{name: scanner, kind: images, repeats: [one.nii.gz]}")
        effects = ["reconstruction_kernel", "hu_calibration"]
        found[name] = vp.diagnose(folder, simulation=tmp_path / "mine.nii.gz", effects=effects).content
    assert found["same"]["verdict"] == "match", found["same"]["sentence"]
    (named,) = found["soft"]["effects"]
    assert named["name"] == "reconstruction_kernel"
    assert named["parameters"]["sigma_mm"]["value"] == pytest.approx(0.6 * 2.4, rel=0.1)
    assert "mean slice" in found["soft"]["modelled"]["limits of the simulation"]
    with pytest.raises(InputError, match="give a simulation of images"):
        vp.diagnose(folder, simulation="mine.h5")
    declared = {"hu_calibration": {"offset_hu": {"value": 5.0, "sd": 0.0}, "scale": {"value": 1.0, "sd": 0.0}}}
    with pytest.raises(InputError, match="simulated images contain HU calibration already"):
        vp.diagnose(folder, simulation=tmp_path / "mine.nii.gz", baseline=declared)
