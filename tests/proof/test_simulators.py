"""Both simulators against path lengths in closed form: random objects, all geometries, errors of the object."""

import importlib.util
import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy import ndimage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.proof_settings import ProofScan
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.shapes import ShapesScene
from virtual_phantom.proof.hiding import gvirtualxray, suite
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.generate import ENERGY_OF_WATER, acquire, scan_of
from virtual_phantom.proof.hiding.gvirtualxray import energy_of_water, lagging, scattered, shared
from virtual_phantom.proof.hiding.hidden_effect import READOUT_KEV
from virtual_phantom.proof.hiding.imperfections import SMALL
from virtual_phantom.proof.hiding.materials import IN_LIBRARY
from virtual_phantom.proof.hiding.meshes import surface
from virtual_phantom.proof.hiding.objects import BODY, PHANTOM, Part, ScannedObject, drawn_object, imperfect
from virtual_phantom.proof.hiding.orbits import image_grid, orbit_of
from virtual_phantom.proof.hiding.readout import read_out
from virtual_phantom.proof.hiding.reconstruction import images_hu
from virtual_phantom.proof.hiding.stated_object import described
from virtual_phantom.proof.hiding.xcist import Acquired, Scan, attenuation_of, isolated
from virtual_phantom.recordings.scan import scan_geometry

MU_WATER = 0.01928
PROTOCOL = ProofScan(5, 1e9, 1000.0, 2, columns=60, rows=2)
EXACT = {"pose": {}, "shape_mm": {}, "object": {}}
SCANNED = drawn_object(PHANTOM, False, generator(branch(1, 9)))
needs_gvxr = pytest.mark.skipif(
    importlib.util.find_spec("gvxrPython3") is None, reason="needs gVirtualXray (environment-proof.txt)"
)


@pytest.mark.parametrize(
    ("simulator", "geometry"),
    [
        ("xcist", "arc"),
        ("xcist", "helical"),
        pytest.param("gvirtualxray", "short_scan", marks=needs_gvxr),
        pytest.param("gvirtualxray", "helical", marks=needs_gvxr),
    ],
)
def test_line_integrals_of_random_rods_follow_the_geometry(simulator, geometry, tmp_path):
    orbit = orbit_of(geometry, SCANNED, PROTOCOL, PROTOCOL, 30.0)
    kev = ENERGY_OF_WATER[simulator](MU_WATER)
    scan = scan_of(orbit, PROTOCOL.photons, 1000.0, kev, {})
    taken = acquire(simulator, scan, SCANNED, EXACT, MU_WATER, 1, branch(1, 8))
    path = tmp_path / "object.yaml"
    path.write_text(yaml.safe_dump(described(SCANNED)))
    scene = ShapesScene(read_object(str(path)).shapes, kev)
    expected = Chain(scene, scan_geometry(orbit.recorded(1000.0), "orbit"), samples=6).state({}).line_integrals()
    difference = -np.log(taken.readings[0] / taken.air) - expected
    assert expected.max() > 3 and np.abs(difference).max() < 0.05 and difference.std() < 5e-3


@pytest.mark.parametrize("axes", [(20.0, 12.0, 9.0), (20.0, 12.0, np.inf)])
def test_meshes_are_closed_wind_inwards_and_have_the_volume(axes):
    vertices, triangles = surface(Part("part", (5.0, -3.0, 1.0), axes, turn_deg=20.0, material="water"))
    a, b, c = vertices[triangles].swapaxes(0, 1)
    volume = (a * np.cross(b, c)).sum() / 6
    expected = 4 / 3 * np.pi * np.prod(axes) if np.isfinite(axes[2]) else np.pi * axes[0] * axes[1] * 300
    assert volume == pytest.approx(-expected, rel=1e-3)
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].tolist() == [2] * (len(edges) // 2)


def test_electronic_noise_of_gvirtualxray_is_in_noise_equivalent_quanta(monkeypatch):
    """Relative to the reading in air it is sigma / N; dark pixels have no other noise."""
    monkeypatch.setattr(gvirtualxray, "_transmission", lambda scan, *_: np.zeros((scan.views, scan.rows, 20, 1)))
    settings = {"electronic_photons": 2000.0, "kvp": 120.0, "aluminium_mm": 3.0}
    scan = Scan(2, 20, 2, 1.0, 1.0, 541.0, 949.0, kev=70.0, photons=1e5, settings=settings)
    taken = gvirtualxray.simulate(scan, SCANNED, MU_WATER, 40, branch(1, 8))
    assert (taken.readings / taken.air).std() == pytest.approx(0.02, rel=4 * np.sqrt(0.5 / taken.readings.size))


def test_errors_of_the_object_have_their_size():
    """A density error in HU is the same for every material; sizes and pose change as stated."""
    attenuation = attenuation_of(70.0)
    names = [part.name for part in SCANNED.parts]
    errors = {"object": dict.fromkeys(names, 4.0), "shape_mm": dict.fromkeys(names, 0.2), "pose": {"x_mm": 1.0}}
    found = imperfect(SCANNED, errors, attenuation, MU_WATER)
    for before, after in zip(SCANNED.parts, found.parts, strict=True):
        mu = [part.attenuation_per_mm(attenuation, MU_WATER) for part in (before, after)]
        assert mu[1] - mu[0] == pytest.approx(0.0 if before.material == "air" else 0.004 * MU_WATER)
        assert np.subtract(after.semi_axes_mm[:2], before.semi_axes_mm[:2]) == pytest.approx(0.2)
        assert after.centre_mm[0] == pytest.approx(before.centre_mm[0] + 1.0)


def test_undeclared_deviations_of_the_largest_body_are_irrelevant(tmp_path):
    """They change the mean of any square of 8 x 8 voxels by less than 1 HU, the default relevance threshold."""
    body = ScannedObject(BODY, (Part("body", (0.0, 0.0, 0.0), (145.0, 108.0, 600.0), material="water"),))
    wanted = replace(PROTOCOL, views=40, columns=64, photons=1e5)
    orbit = orbit_of("flat", body, wanted, wanted, 0.0)
    grid = replace(image_grid(orbit), shape=(1, 64, 64))
    path = tmp_path / "object.yaml"
    path.write_text(yaml.safe_dump(described(body)))
    scene = ShapesScene(read_object(str(path)).shapes, energy_of_water(MU_WATER))
    lines = 1.06 * Chain(scene, scan_geometry(orbit.recorded(1000.0), "orbit"), samples=2).state({}).line_integrals()
    air = np.full(lines.shape[1:], wanted.photons * READOUT_KEV)
    inside = ndimage.binary_erosion(body.parts[0].shape.level(*np.ix_(*grid.axes_mm()))[0] < 0, iterations=2)
    inside = ndimage.binary_erosion(inside, np.ones((8, 8)))

    def image(settings):
        scan = scan_of(orbit, wanted.photons, 1000.0, 70.0, settings)
        readings = scattered((np.exp(-lines) * air)[..., None], air[None, ..., None], scan)[None, ..., 0]
        taken = read_out(Acquired(lagging(readings, scan), air), settings, (9.0, 9.0), 1.0, np.random.default_rng(1))
        return images_hu(-np.log(taken.readings[0] / taken.air), scan, grid, MU_WATER)[0]

    exact = image({})
    for name in SMALL.keys() - {"detector_offset"}:  # its rays are shifted, which changes no mean
        settings, _ = CATALOGUE[name].make(SMALL[name] * CATALOGUE[name].ranges[0][0], np.random.default_rng(2))
        change = np.abs(ndimage.uniform_filter(image(settings) - exact, 8)[inside]).max()
        assert 0 < change < 1, name


def test_light_spreads_from_a_depth_of_one_pixel():
    """Shares in proportion to 1 / (1 + n^2): the integral of (1 + x^2 + y^2)^(-3/2) over y is 2 / (1 + x^2)."""
    counts = np.zeros((9, 11, 1))
    counts[4, 5] = 1
    y = np.linspace(-2000, 2000, 4_000_001)
    light = np.array([np.trapezoid((1 + n**2 + y**2) ** -1.5, y) for n in (1, 2, 3)])
    side = 0.1 * light / light.sum()
    row = [0, 0, *side[::-1], 0.8, *side, 0, 0]
    np.testing.assert_allclose(shared(counts, 0.1, 0.0)[4, :, 0], row, atol=1e-7)
    np.testing.assert_allclose(shared(counts, 0.0, 0.1)[1:8, 5, 0], row[2:9], atol=1e-7)
    assert shared(counts, 0.1, 0.05).sum() == pytest.approx(1)


def test_noise_of_gvirtualxray_is_that_of_photons_and_electronics(monkeypatch):
    """Readings are energies: a hundredth of 1e5 photons of 70 keV, and electronic noise of 100 photons."""
    scan = scan_of(orbit_of("flat", SCANNED, PROTOCOL, PROTOCOL, 0.0), 1e5, 1000.0, 70.0, {"electronic_photons": 100.0})
    shape = scan.views, scan.rows, scan.columns, 1
    monkeypatch.setattr(gvirtualxray, "_transmission", lambda *given: np.full(shape, 0.01))
    taken = gvirtualxray._simulate(scan, SCANNED, MU_WATER, 40, branch(1, 8))
    fluence = taken.air / taken.air[:, scan.columns // 2].mean()
    assert (taken.readings / 70).mean() == pytest.approx(1e3 * fluence.mean(), rel=0.01)
    assert (taken.readings / 70).var(axis=0, ddof=1).mean() == pytest.approx(100.0**2 + 1e3 * fluence.mean(), rel=0.02)


def test_stated_materials_attenuate_as_the_librarys():
    """A material of the library is stated by its name alone."""
    kev = energy_of_water(MU_WATER)
    for name in IN_LIBRARY:
        assert attenuation_per_mm(name, [kev])[0] == pytest.approx(gvirtualxray.attenuation_of(kev)(name), rel=1e-3), (
            name
        )


def test_missing_simulator_is_one_line(monkeypatch):
    monkeypatch.setattr(suite.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"proof.simulators: gvirtualxray needs the package gvxr.*environment-proof"):
        suite.check_simulators(("xcist", "gvirtualxray"))
    suite.check_simulators(("xcist",))


def test_missing_library_of_the_system_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "gvxrPython3", None)  # its import fails
    with pytest.raises(InputError, match=r"gVirtualXray does not start \(.*gvxrPython3.*Debian packages"):
        gvirtualxray._transmission(None, None, MU_WATER, np.array([60.0]))


def crash(log, attempts):
    """Crash in the first attempts, each of which adds a letter to the log; then return their number."""
    with open(log, "a") as file:
        file.write("x")
    if log.stat().st_size <= attempts:
        os.kill(os.getpid(), signal.SIGKILL)
    return log.stat().st_size


def test_scan_is_repeated_if_the_simulator_crashes(tmp_path):
    assert isolated(crash, tmp_path / "twice", 2) == 3
    with pytest.raises(InputError, match="crashed or was killed 3 times.*with fewer cores"):
        isolated(crash, tmp_path / "always", 9)
