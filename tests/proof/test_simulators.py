"""Both simulators against path lengths in closed form: random objects, all geometries, errors of the object."""

import importlib.util

import numpy as np
import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.proof_settings import ProofScan
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.shapes import ShapesScene
from virtual_phantom.proof.hiding import gvirtualxray, suite
from virtual_phantom.proof.hiding.generate import ENERGY_OF_WATER, acquire, scan_of
from virtual_phantom.proof.hiding.meshes import surface
from virtual_phantom.proof.hiding.objects import PHANTOM, Part, drawn_object, imperfect
from virtual_phantom.proof.hiding.orbits import orbit_of
from virtual_phantom.proof.hiding.stated_object import described
from virtual_phantom.proof.hiding.xcist import Scan, attenuation_of
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
    taken = acquire(simulator, scan, orbit, SCANNED, EXACT, MU_WATER, 1, branch(1, 8))
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
    scan = Scan(2, 20, 2, 1.0, 1.0, 541.0, 949.0, 70.0, 1e5, settings=settings)
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


def test_missing_simulator_is_one_line(monkeypatch):
    monkeypatch.setattr(suite.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"proof.simulators: gvirtualxray needs the package gvxr.*environment-proof"):
        suite.check_simulators(("xcist", "gvirtualxray"))
    suite.check_simulators(("xcist",))
