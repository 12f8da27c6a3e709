"""Bowtie filter and heel effect: transmission of every energy, pixel by pixel."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from virtual_phantom.base.geometry import circular
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.beam.sensors import response
from virtual_phantom.physics.beam.spectra import Anode, tube_spectrum
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.physics.state import State

SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0)
GEOMETRY = circular(
    views=2,
    **SCANNER,
    columns=81,
    rows=21,
    column_pitch_mm=10.0,
    row_pitch_mm=6.0,
)
KEV = 60.0  # of a DiscScene
SPECTRUM = {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}


class Slab:
    """Equal path lengths through every material along all rays."""

    energy_kev, threads = KEV, 1

    def __init__(self, **paths_mm):
        self.materials, self.paths_mm = tuple(paths_mm), list(paths_mm.values())
        self.attenuation_per_mm = np.array([attenuation_per_mm(name, [KEV])[0] for name in self.materials])

    def path_lengths(self, geometry, pose, motion_mm=None):
        paths = np.array(self.paths_mm)[:, None, None, None]
        return np.broadcast_to(paths, (len(paths), *geometry.shape)).astype(np.float32)


def through(slab, aluminium_mm=0.0, target="tungsten", target_mm=0.0):
    """Signal and noise behind a slab relative to air.

    Sums over all energies of SPECTRUM through the filters and the slab into the sensor.
    """
    energies, fluence = tube_spectrum(SPECTRUM["kvp"])
    detected, *moments = response("caesium_iodide", 0.6, energies)
    photons = fluence * detected * np.exp(-attenuation_per_mm("aluminium", energies) * SPECTRUM["filtration_mm"])
    filters = (
        attenuation_per_mm("aluminium", energies) * aluminium_mm + attenuation_per_mm(target, energies) * target_mm
    )
    inside = sum(attenuation_per_mm(m, energies) * mm for m, mm in zip(slab.materials, slab.paths_mm, strict=True))
    return [(photons * moment * np.exp(-filters - inside)).sum() / (photons * moment).sum() for moment in moments]


BOWTIE = load("bowtie").values({"at_20deg_mm": 15.0})


@pytest.mark.parametrize(
    ("name", "profile", "middle_mm"),
    [("large", (31.8, 3.54, 14.9), 2.55), ("medium", (32.7, 3.27, 13.0), 0.94), ("small", (32.7, 2.82, 10.8), 1.1)],
)
def test_saturating_bowtie_resembles_those_of_body_scanners(name, profile, middle_mm):
    """XCIST's three bowties: fan angles in radians and aluminum in cm."""
    import gecatsim

    file = Path(gecatsim.__file__).parent / "bowtie" / f"{name}.txt"
    table = np.loadtxt(file, comments=["#", "%"])
    values = dict(zip(("at_20deg_mm", "exponent", "levels_off_deg"), profile, strict=True))
    state = State(circular(views=1, columns=401, rows=1, column_pitch_mm=2.0, row_pitch_mm=1.0, **SCANNER))
    load("bowtie").apply(state, values)
    fan, (_, thickness) = state.geometry.fan_angles_rad(), state.filters[0]
    inside = np.abs(fan) < np.deg2rad(25)
    expected = 10 * np.interp(fan[inside], table[:, 0], table[:, 1]) - middle_mm
    assert np.abs(thickness[0, inside] - expected).max() < 1.1


def bowtie_mm(geometry, at_20deg_mm):
    fan = np.arctan(geometry.column_positions_mm() / geometry.source_to_detector_mm)
    return at_20deg_mm * (fan / np.deg2rad(20)) ** 2


def heel_mm(geometry, depth_mm, anode_deg):
    """Path in the target relative to that of the central ray, from the angle between ray and surface.

    The anode's normal tilts away from its own side.
    """
    normal = np.array([-np.cos(np.deg2rad(anode_deg)), np.sin(np.deg2rad(anode_deg))])  # along z, towards the detector
    rays = np.stack([geometry.row_positions_mm(), np.full(geometry.rows, geometry.source_to_detector_mm)])
    rays /= np.linalg.norm(rays, axis=0)
    return depth_mm / (normal @ rays) - depth_mm / np.sin(np.deg2rad(anode_deg))


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("slab", [Slab(water=50.0), Slab(water=200.0, bone=15.0)])
def test_bowtie_hardens_column_by_column(slab, samples):
    chain = Chain(slab, GEOMETRY, samples=samples)
    state = chain.state({"spectrum": SPECTRUM, "bowtie": BOWTIE})
    lines, thickness = state.line_integrals()[0, 0], bowtie_mm(GEOMETRY, 15.0)
    for column in (0, 10, 40, 60):
        signal, noise = through(slab, thickness[column])
        air, _ = through(Slab(water=0.0), thickness[column])
        assert lines[column] == pytest.approx(-np.log(signal / air), rel=2e-3)
        assert state.air[0, 0, column] == pytest.approx(air, rel=2e-3)
        assert state.noise[0, 0, column] == pytest.approx(noise, rel=5e-3)
    # Behind 15 mm of aluminum (20 degrees off the central ray), 50 mm of water attenuates 7 % less.
    at_20 = np.argmin(np.abs(thickness - 15.0))
    assert slab.paths_mm[0] > 50 or lines[at_20] / lines[40] - 1 == pytest.approx(-0.07, abs=0.01)


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("angle", [12.0, -12.0])
def test_heel_hardens_row_by_row_towards_the_anode(angle, samples):
    slab = Slab(water=200.0)
    physics = {"spectrum": SPECTRUM, "heel": {"depth_um": 10.0}}
    state = Chain(slab, GEOMETRY, samples=samples).state(physics, anode=Anode("W", angle))
    thickness = heel_mm(GEOMETRY, 0.01, abs(angle))[:: int(np.sign(angle))]
    lines = state.line_integrals()[0, :, 40]
    for row in (0, 5, 10, 20):
        signal, _ = through(slab, target_mm=thickness[row])
        air, _ = through(Slab(water=0.0), target_mm=thickness[row])
        assert lines[row] == pytest.approx(-np.log(signal / air), rel=2e-3)
        assert state.air[0, row, 40] == pytest.approx(air, rel=2e-3)
    towards = 20 if angle > 0 else 0
    assert lines[towards] < lines[20 - towards] and state.air[0, towards, 0] < 0.97 * state.air[0, 10, 0]
    other = Chain(slab, GEOMETRY).state(physics | {"heel": {"depth_um": -10.0}}, anode=Anode("W", angle))
    np.testing.assert_allclose(other.air, state.air[:, ::-1], rtol=1e-6)


def test_monochromatic_beam_is_attenuated_and_not_hardened():
    chain = Chain(DiscScene(160.0, "water"), GEOMETRY)
    plain = chain.state({}).line_integrals()
    bowtie, heel = chain.state({"bowtie": BOWTIE}), chain.state({"heel": {"depth_um": 10.0}})
    thickness = bowtie_mm(GEOMETRY, 15.0)
    expected = attenuation_per_mm("aluminium", [KEV])[0] * thickness
    np.testing.assert_allclose(-np.log(bowtie.air[0, 0]), expected, rtol=1e-9, atol=1e-12)
    expected = attenuation_per_mm("tungsten", [KEV])[0] * heel_mm(GEOMETRY, 0.01, 12.0)
    np.testing.assert_allclose(-np.log(heel.air[0, :, 0]), expected, rtol=1e-9, atol=1e-12)
    for state in (bowtie, heel):
        np.testing.assert_allclose(state.line_integrals(), plain, atol=1e-9)
        np.testing.assert_allclose(state.variance() * state.air, chain.state({}).variance(), rtol=1e-9)


@pytest.mark.parametrize("physics", [{"bowtie": BOWTIE}, {"heel": {"depth_um": 10.0}}])
@pytest.mark.parametrize("spectrum", [{}, {"spectrum": SPECTRUM}])
def test_other_detector_and_collimation_have_the_same_parameters(physics, spectrum):
    """The same rays get the same light.

    The other detector has half the size, columns and rows, or another distance.
    """
    slab = Slab(water=100.0)
    whole = Chain(slab, GEOMETRY).state(physics | spectrum)
    narrow = Chain(slab, replace(GEOMETRY, columns=41, rows=11)).state(physics | spectrum)
    np.testing.assert_allclose(narrow.air[0], whole.air[0, 5:16, 20:61], rtol=1e-9)
    np.testing.assert_allclose(narrow.line_integrals()[0], whole.line_integrals()[0, 5:16, 20:61], rtol=1e-6)
    far = replace(GEOMETRY, source_to_detector_mm=1500.0, column_pitch_mm=15.0, row_pitch_mm=9.0)
    np.testing.assert_allclose(Chain(slab, far).state(physics | spectrum).air, whole.air, rtol=1e-9)


def test_parabola_misses_xcists_bowties_within_the_model_accuracy():
    """Relative root mean square error of the best parabola within fans of 13, 20 and 27.6 degrees."""
    profiles = ((31.8, 3.54, 14.9), (32.7, 3.27, 13.0), (32.7, 2.82, 10.8))  # bowtie in the effects reference
    missed = []
    for half_fan in (13.0, 20.0, 27.6):
        fan = np.linspace(-half_fan, half_fan, 889)
        for thickness, exponent, width in profiles:
            true = thickness * np.expm1(-((np.abs(fan) / width) ** exponent)) / np.expm1(-((20 / width) ** exponent))
            left = true - fan**2 * (fan**2 @ true) / (fan**2 @ fan**2)
            missed.append(np.sqrt((left @ left) / (true @ true)))
    assert (min(missed), np.median(missed), max(missed)) == pytest.approx((0.05, 0.18, 0.39), abs=0.006)
    assert min(missed) < defaults_of("diagnosis", "model_accuracy")["bowtie"] < np.median(missed)
