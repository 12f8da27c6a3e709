"""Sensor response and its noise, against closed forms and a Monte Carlo simulation of single photons."""

import numpy as np
import pytest
import xraylib
from scipy.integrate import quad
from scipy.special import k0
from simulated_scans import noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.projections.model import ScansModel
from virtual_phantom.io.exchange import write_line_integrals
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.beam.sensors import COUNTS, ENERGY, SENSORS, Sensor, response, sensor_from_label
from virtual_phantom.physics.beam.spectra import TUNGSTEN, tube_spectrum, weighted_spectrum
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.physics.spread import long_tailed_spread
from virtual_phantom.physics.stored_state import read_state, to_store

SPECTRUM = {"kvp": 120.0, "filtration_mm": 3.0, "sensor_mm": 0.6}
GEOMETRY = circular(
    views=6,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=1000.0,
    columns=60,
    rows=8,
    column_pitch_mm=6.0,
    row_pitch_mm=6.0,
)


# Mass attenuation of cesium iodide, and coherent scattering in it, cm^2/g: J. H. Hubbell and S. M. Seltzer, NISTIR
# 5632.
@pytest.mark.parametrize(("kev", "mass", "share"), [(80.0, 3.677, 0.63), (100.0, 2.035, 0.42)])
def test_layer_absorbs_as_published_cross_sections_state(kev, mass, share):
    """Coherent scattering, below a twentieth, is excluded; energies are far from total absorption."""
    whole = 1 - np.exp(-mass * 4.51 * 0.06)
    assert whole == pytest.approx(share, abs=0.005)
    assert 0.95 * whole < response("caesium_iodide", 0.6, [kev])[0][0] < whole


@pytest.mark.parametrize("kev", [36.5, 60.0, 100.0])
def test_k_fluorescence_escape_of_a_thick_layer_has_its_closed_form(kev):
    """Escape through the front:

    (1 - m ln(1 + 1/m)) / 2, where m is the attenuation of the K photon relative to the incident one (P. Axel, Rev. Sci.
    Instrum. 25, 391, 1954).

    Compton scattering and the sulfur, which the closed form neglects, account for less than 0.6 %.
    """
    material, number = "gadolinium_oxysulfide", 64
    _, first, _ = response(material, 20.0, [kev])

    def mu(energy):
        formula = SENSORS[material][0]
        return xraylib.CS_Photo_CP(formula, energy) + xraylib.CS_Compt_CP(formula, energy)

    lost = 0.0
    if kev > 50.24:
        mass = xraylib.CompoundParser("Gd2O2S")["massFractions"][-1]
        part = mass * xraylib.CS_Photo(number, kev) / xraylib.CS_Photo_CP("Gd2O2S", kev) * (1 - 1 / 5.537) * 0.932
        for line, share in ((42.75, 0.7993), (47.59, 0.2007)):
            m = mu(line) / mu(kev)
            lost += part * share * (1 - m * np.log(1 + 1 / m)) / 2 * line
    assert first[0] / kev == pytest.approx(1 - lost / kev, abs=0.006)


def deposits(material, thickness_mm, kev, count, random):
    """Energies that photons deposit in a layer, without those that pass it: single photons, each in its direction."""
    formula, density, _ = SENSORS[material]

    def mu(energy):
        return (xraylib.CS_Photo_CP(formula, energy) + xraylib.CS_Compt_CP(formula, energy)) * density / 10

    depth = random.exponential(1 / mu(kev), count)
    depth = depth[depth < thickness_mm]
    left = np.full(depth.size, kev)

    def leaves(which, energies, cosines):
        way = np.where(cosines > 0, thickness_mm - depth[which], depth[which]) / np.abs(cosines)
        table = {energy: mu(energy) for energy in np.unique(energies)}
        free = random.exponential(1, which.size) / np.array([table[energy] for energy in energies])
        gone = free > way
        left[which[gone]] -= energies[gone]

    photo = xraylib.CS_Photo_CP(formula, kev)
    scattered = random.random(depth.size) > photo / (photo + xraylib.CS_Compt_CP(formula, kev))
    # Klein-Nishina by rejection, with energies in steps of 0.1 keV to limit the number of cross sections.
    which = np.flatnonzero(scattered)
    cosines = np.empty(which.size)
    for place in range(which.size):
        while True:
            cosine = random.uniform(-1, 1)
            ratio = 1 / (1 + kev / 511 * (1 - cosine))
            if random.random() * 2 < ratio**2 * (ratio + 1 / ratio - 1 + cosine**2):
                cosines[place] = cosine
                break
    leaves(which, np.round(kev / (1 + kev / 511 * (1 - cosines)), 1), cosines)
    compound = xraylib.CompoundParser(formula)
    elements = compound["Elements"]
    shares = np.array(
        [part * xraylib.CS_Photo(z, kev) for z, part in zip(elements, compound["massFractions"], strict=True)]
    )
    absorbed = np.flatnonzero(~scattered)
    hit = random.choice(len(elements), absorbed.size, p=shares / shares.sum())
    for place, z in enumerate(elements):
        if z < 20 or kev < xraylib.EdgeEnergy(z, xraylib.K_SHELL):
            continue
        chance = (1 - 1 / xraylib.JumpFactor(z, xraylib.K_SHELL)) * xraylib.FluorYield(z, xraylib.K_SHELL)
        which = absorbed[hit == place]
        which = which[random.random(which.size) < chance]
        alpha = random.random(which.size) < xraylib.RadRate(z, xraylib.KA_LINE)
        lines = np.where(alpha, *(xraylib.LineEnergy(z, line) for line in (xraylib.KA_LINE, xraylib.KB_LINE)))
        leaves(which, lines, random.uniform(-1, 1, which.size))
    return left


@pytest.mark.parametrize(
    ("material", "thickness_mm", "kev"),
    [("caesium_iodide", 0.6, 40.0), ("caesium_iodide", 0.6, 110.0), ("gadolinium_oxysulfide", 0.1, 60.0)]
    + [("cadmium_telluride", 1.6, 60.0), ("silicon", 30.0, 60.0)],
)
def test_moments_agree_with_single_photons(material, thickness_mm, kev):
    count = 100_000
    found = deposits(material, thickness_mm, kev, count, np.random.default_rng(3)) / kev
    detected, first, second = (float(one[0]) for one in response(material, thickness_mm, [kev]))
    assert found.size / count == pytest.approx(detected, abs=4 * np.sqrt(detected * (1 - detected) / count) + 1e-4)
    assert found.mean() == pytest.approx(first / kev, abs=4 * found.std() / np.sqrt(found.size))
    square = found**2
    assert square.mean() == pytest.approx(second / kev**2, abs=4 * square.std() / np.sqrt(found.size))
    assert first**2 < second < 0.99 * kev**2


def test_counted_photons_have_unit_weight():
    energies = np.array([20.0, 60.0, 110.0])
    counted, integrated = (response("cadmium_telluride", 1.6, energies, reads) for reads in (COUNTS, ENERGY))
    assert np.array_equal(counted[0], integrated[0]) and (counted[1] == 1).all() and (counted[2] == 1).all()
    spectrum = weighted_spectrum(120.0, 6.0, sensor=Sensor("cadmium_telluride", COUNTS), sensor_mm=1.6)
    np.testing.assert_allclose(spectrum.noise, spectrum.signal, rtol=1e-6)


def test_prior_of_a_sensor():
    unknown, material = sensor_from_label(), sensor_from_label("gadolinium_oxysulfide")
    stated = sensor_from_label("caesium_iodide", 0.4)
    assert (unknown.material, unknown.thickness_mm, unknown.thickness_sd) == ("caesium_iodide", 0.6, 1.0)
    assert (material.thickness_mm, material.thickness_sd) == (1.4, 0.5)
    assert (stated.thickness_mm, stated.thickness_sd) == (0.4, 0.05)
    with pytest.raises(InputError, match="sensor 'glass' is unknown; use one of caesium_iodide"):
        sensor_from_label("glass")
    with pytest.raises(InputError, match="sensor signal 'light' is unknown"):
        sensor_from_label("silicon", 30.0, "light")


def test_fit_constrains_the_thickness_by_its_prior():
    for sensor in (
        sensor_from_label(),
        sensor_from_label("gadolinium_oxysulfide"),
        sensor_from_label("caesium_iodide", 0.4),
    ):
        model = ScansModel(Chain(DiscScene(160.0, "water"), GEOMETRY, sensor=sensor), ())
        (one,) = (unknown for unknown in model.unknowns(("spectrum",)) if unknown.name == "sensor_mm")
        assert one.value(one.expected) == pytest.approx(sensor.thickness_mm)
        assert one.sd == sensor.thickness_sd and one.starts == (one.expected,)
        assert one.low <= one.expected - 4 * one.sd and one.high >= one.expected + 5 * one.sd


def test_stored_state_keeps_its_noise(tmp_path):
    chain = Chain(DiscScene(160.0, "water"), GEOMETRY)
    for physics in ({"spectrum": SPECTRUM}, {"electronic_noise": {"photons": 20.0}}):
        state = chain.state(physics)
        write_line_integrals(tmp_path / "clean.h5", state.line_integrals(), GEOMETRY, to_store(state))
        found = read_state(tmp_path / "clean.h5")
        np.testing.assert_allclose(found.variance(), state.variance(), rtol=1e-5)


@pytest.mark.parametrize("kvp", [80.0, 140.0])
@pytest.mark.parametrize("water_mm", [50.0, 350.0])
def test_few_energies_have_the_mean_and_variance_of_all(kvp, water_mm):
    """Behind water; the variance exceeds that of equal photons of the same number by a fifth or more."""
    energies, fluence = tube_spectrum(kvp, TUNGSTEN)
    detected, first, second = response("caesium_iodide", 0.6, energies)
    photons = fluence * detected * np.exp(-attenuation_per_mm("aluminium", energies) * 3.0)
    left = np.exp(-attenuation_per_mm("water", energies) * water_mm)
    signal, noise = ((photons * one * left).sum() / (photons * one).sum() for one in (first, second))
    few = weighted_spectrum(kvp, 3.0)
    left = np.exp(-attenuation_per_mm("water", few.energies_kev) * water_mm)
    assert (few.signal * left).sum() == pytest.approx(signal, rel=1e-3)
    assert (few.noise * left).sum() == pytest.approx(noise, rel=5e-3)
    assert noise / signal > (1.2 if water_mm > 300 else 1.05)


@pytest.mark.parametrize("more", [{}, {"scatter": {"amount": 0.2, "width_mm": 30.0}}, {"xray_crosstalk": {}}])
def test_simulated_noise_has_the_variance_of_weighted_photons(more):
    """Against realizations of the photons of every energy.

    Scatter and crosstalk leave noise and signal in the same pixels.
    """
    chain = Chain(DiscScene(250.0, "water"), GEOMETRY, photons=5e4)
    physics = {"spectrum": SPECTRUM} | {name: load(name).values(values) for name, values in more.items()}
    state, random = chain.state(physics), np.random.default_rng(5)
    scans = noisy_lines(state, 60, random)
    ratio = scans.var(axis=0, ddof=1) / state.variance()
    assert ratio.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / 59 / ratio.size) + 2e-3)
    thickest = (slice(None), slice(3, 5), slice(27, 33))
    assert (state.noise / state.signal)[thickest].mean() > 1.15
    if more:
        return
    spectrum, path = weighted_spectrum(120.0, 3.0), chain.scene.path_lengths(GEOMETRY)[0][thickest].astype(float)
    left = np.exp(-path[..., None] * attenuation_per_mm("water", spectrum.energies_kev))
    # For n photons of weight e, n e is the signal and n e^2 the variance.
    each = spectrum.noise / spectrum.signal / 5e4
    drawn = (random.poisson(np.broadcast_to(left * spectrum.signal / each, (400, *left.shape))) * each).sum(axis=-1)
    ratio = drawn.var(axis=0, ddof=1) / (state.noise[thickest] / 5e4)
    assert ratio.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / 399 / ratio.size))


def test_glare_within_a_radius_has_its_closed_form():
    """1 - exp(-r / w) of exp(-r / w) / (2 pi w r); on one row, the integral of K0(x / w) / (pi w)."""
    width_mm, pixel = 20.0, {"column_pitch_mm": 1.0, "row_pitch_mm": 1.0}
    square, line = (
        circular(views=1, source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0, columns=301, rows=rows, **pixel)
        for rows in (301, 1)
    )
    bright = np.zeros((1, 301, 301))
    bright[0, 150, 150] = 1.0
    found = long_tailed_spread(bright, square, width_mm)[0]
    away = np.hypot(*np.indices(found.shape) - 150)
    radii = np.arange(3.5, 120, 4)
    np.testing.assert_allclose([found[away < r].sum() for r in radii], 1 - np.exp(-radii / width_mm), atol=0.02)
    found = long_tailed_spread(bright[:, 150:151], line, width_mm)[0, 0]
    closed = [quad(lambda x: k0(x / width_mm) / (np.pi * width_mm), 0, r)[0] for r in radii]
    np.testing.assert_allclose([found[151 : 150 + int(r + 1)].sum() + found[150] / 2 for r in radii], closed, atol=0.01)


def test_wide_light_spread_adds_no_noise():
    """Counts of many pixels with a tenth of each spread over all: (1 - g)^2 of the variance."""
    chain = Chain(DiscScene(100.0, "water"), GEOMETRY, photons=1e4)
    state = chain.state({"veiling_glare": {"share": 0.1, "width_mm": 200.0, "beyond": 0.0}})
    np.testing.assert_allclose(state.noise, 0.81 * chain.state({}).signal)
    random = np.random.default_rng(2)
    drawn = random.poisson(1e4, (400, 480))
    veiled = 0.9 * drawn + 0.1 * drawn.mean(axis=1, keepdims=True)
    assert veiled.var(axis=0, ddof=1).mean() / 1e4 == pytest.approx(0.81, abs=4 * 0.81 * np.sqrt(2 / 399 / 480) + 1e-3)
