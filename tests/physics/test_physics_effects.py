"""Every effect against a closed form, and the chain against the baseline."""

import itertools
import math

import numpy as np
import pytest
from simulated_scans import body, noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.diagnosis.projections.observed import Scans, observe
from virtual_phantom.physics.beam.materials import Segmentation, attenuation_per_mm, energy_of
from virtual_phantom.physics.beam.spectra import Anode, tube_spectrum, weighted_spectrum
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import STAGES, acts_on_images, checked, load, names
from virtual_phantom.physics.noise.correlation import correlations
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.physics.scenes.sampling import (
    FEW_POINTS,
    FEW_POINTS_PX,
    MIN_POINTS,
    displace_source,
    pixel_quadrature,
    points,
)
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.physics.state import Sharing, State, with_afterglow, with_crosstalk
from virtual_phantom.simulation.reconstruct import apply_image_effects

MU = 0.0193
SCANNER = dict(
    views=24,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=1000.0,
    columns=48,
    rows=6,
    column_pitch_mm=6.0,
    row_pitch_mm=6.0,
    view_interval_ms=20.0,
)
GEOMETRY, HELIX = circular(**SCANNER), helical(volume_height_mm=30.0, **SCANNER)


@pytest.fixture(scope="module")
def phantom():
    grid = Grid((10, 40, 40), (4.0, 3.0, 3.0))
    return body(grid, (50, 40), 30.0, [((20, 0, 0), 12, 900.0)])


@pytest.fixture(scope="module")
def chain(phantom):
    return Chain(VoxelScene.of(phantom, Segmentation(), MU), GEOMETRY, photons=2e5)


# Mass attenuation (cm^2/g) at 60 keV and density: J. H. Hubbell and S. M. Seltzer, NISTIR 5632 (1995).
@pytest.mark.parametrize(
    ("material", "mass", "density"),
    [("water", 0.2059, 1.0), ("aluminium", 0.2778, 2.699), ("copper", 1.593, 8.96), ("pmma", 0.1924, 1.19)],
)
def test_attenuation_equals_published_tables(material, mass, density):
    assert attenuation_per_mm(material, [60.0])[0] == pytest.approx(mass * density / 10, rel=0.005)


def test_energy_of_a_monochromatic_beam():
    assert energy_of("water", attenuation_per_mm("water", [70.0])[0]) == pytest.approx(70, abs=1e-3)
    with pytest.raises(InputError, match="is not the attenuation of water at any energy"):
        energy_of("water", 5.0)


def test_materials_add_up_to_the_hu():
    hu = np.array([-1000, -500, 0, 100, 200, 1000, 2500, 4000.0], np.float32)
    for segmentation in (Segmentation(), Segmentation(dense=None), Segmentation("soft_tissue", "bone", 80)):
        energy = energy_of("water", MU)
        mu = [attenuation_per_mm(material, [energy])[0] for material in segmentation.materials]
        fractions = segmentation.fractions(hu, MU)
        np.testing.assert_allclose(np.tensordot(mu, fractions, 1), (hu / 1000 + 1) * MU, rtol=1e-5, atol=1e-8)
        assert (fractions >= -1e-6).all()


def test_chain_without_effects_equals_the_baseline(phantom, chain):
    found = chain.state({}).line_integrals()
    np.testing.assert_allclose(found, clean_line_integrals(phantom, GEOMETRY, MU), atol=2e-5)


@pytest.mark.parametrize("name", [name for name in names() if not acts_on_images(name)])
def test_effect_at_its_neutral_value_changes_nothing(chain, name):
    effect = load(name)
    assert (
        effect.name == name
        and effect.stage in STAGES
        and all((effect.physics, effect.equation, effect.source, effect.signature, effect.settled_by))
    )
    values = effect.values({})
    varied = [parameter for parameter in effect.parameters if parameter.neutral is not None]
    there = {} if effect.beside is None else {effect.beside: load(effect.beside).values({})}
    if name == "current_along_z":
        chain = chain.copy(HELIX)
    state, baseline = chain.state(there | {name: values}), chain.state(there)
    changed = [state.line_integrals(), state.variance(), correlations(state)]
    same = [baseline.line_integrals(), baseline.variance(), correlations(baseline)]
    assert any((a != b).any() for a, b in zip(changed, same, strict=True)), "typical strength does nothing"
    if varied:
        off = chain.state(there | {name: values | {parameter.name: parameter.neutral for parameter in varied}})
        for a, b in zip((off.line_integrals(), off.variance()), same, strict=False):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_settings_are_checked():
    assert checked({"scatter": None}) == {"scatter": {"amount": 0.05, "width_mm": 60.0}}
    for settings, message in [
        ({"glow": {}}, "there is no effect 'glow'"),
        ({"scatter": {"ratio": 1}}, "scatter: has no ratio"),
        ({"scatter": {"amount": 3}}, "amount: 3 is out of the plausible range, 0 to 0.6"),
        ({"scatter": {"amount": math.nan}}, "is no finite number"),
    ]:
        with pytest.raises(InputError, match=message):
            checked(settings)


def test_spectrum_hardens_as_the_sum_over_its_energies():
    spectrum = weighted_spectrum(120.0, 6.0)
    energies, shares = spectrum.energies_kev, spectrum.signal
    assert shares.sum() == pytest.approx(1) and 10 < energies[0] < energies[-1] <= 120
    scene = DiscScene(160.0, "water")
    chain = Chain(scene, GEOMETRY)
    path = scene.path_lengths(GEOMETRY)[0].astype(float)
    mu = attenuation_per_mm("water", energies)
    right = -np.log((shares * np.exp(-path[..., None] * mu)).sum(axis=-1))
    found = chain.state({"spectrum": {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}}).line_integrals()
    np.testing.assert_allclose(found, right, atol=1e-5)
    thick, thin = path > 150, (path > 5) & (path < 90)
    assert (found[thick] / path[thick]).max() < (found[thin] / path[thin]).min() < (shares * mu).sum()


def test_spectra_follow_voltage_and_filter():
    # With SpekPy's own attenuation data: s = Spek(kvp=120, th=12); s.filter("Al", 2.5); s.get_emean() is 54.44 keV.
    energies, fluence = tube_spectrum(120.0)
    filtered = fluence * np.exp(-2.5 * attenuation_per_mm("aluminium", energies))
    assert (energies * filtered).sum() / filtered.sum() == pytest.approx(54.44, rel=0.01)
    assert tube_spectrum(80.5)[0].max() <= 80.5 + 0.5
    with pytest.raises(InputError, match="spectra of a Mo anode go from 20 to 50 kV"):
        tube_spectrum(120.0, Anode("Mo"))


def test_scatter_of_a_wide_slab_equals_the_loss_of_the_primary(chain):
    """Far from all edges the kernel's width does not matter."""
    state = chain.state({})
    state.signal = np.full_like(state.signal, 0.2)
    state.geometry = circular(
        views=24,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=48,
        rows=6,
        column_pitch_mm=60.0,
        row_pitch_mm=600.0,
    )
    load("scatter").apply(state, {"amount": 0.1, "width_mm": 60.0})
    assert state.signal[5, 3, 24] == pytest.approx(0.2 + 0.1 * 0.2 * math.log(5), rel=1e-3)


class Parabola:
    """Path lengths that grow with the square of the distance from the detector center, too short to harden the beam."""

    attenuation_per_mm = np.array([1.0])

    def path_lengths(self, geometry, pose, motion_mm=None):
        columns, rows = geometry.column_positions_mm() ** 2, geometry.row_positions_mm()[:, None] ** 2
        return np.broadcast_to(1e-8 * (columns + 2 * rows), (1, *geometry.shape))


@pytest.mark.parametrize("samples", [2, 3, 4])
def test_rays_of_a_pixel_average_like_the_whole_pixel(samples):
    """The mean over a pixel of width w exceeds the central value of a parabola by w^2 / 12."""
    square = 12 * 1e-8 * (GEOMETRY.column_pitch_mm**2 + 2 * GEOMETRY.row_pitch_mm**2) / 144
    middle = Chain(Parabola(), GEOMETRY).state({}).signal
    found = Chain(Parabola(), GEOMETRY, samples=samples).state({}).signal
    np.testing.assert_allclose(middle - found, square, rtol=1e-3)


def test_rays_of_a_fan_beam_stay_in_the_plane():
    assert {row for (_, row), _ in pixel_quadrature(3, of_rows=False)} == {0.0}
    assert sum(weight for _, weight in pixel_quadrature(3, of_rows=False)) == pytest.approx(1.0)


def test_focal_spot_blurs_by_its_shadow():
    """A thin disc at the isocenter: the variance of its shadow grows by w^2/12 (D - R)^2/R^2."""
    geometry = circular(
        views=4,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=2000,
        rows=1,
        column_pitch_mm=0.02,
        row_pitch_mm=1.0,
    )
    chain = Chain(DiscScene(4.0, "water"), geometry)
    u = geometry.column_positions_mm()

    def spread(physics):
        shadow = 1 - chain.state(physics).signal[0, 0]
        return (shadow * u**2).sum() / shadow.sum() - ((shadow * u).sum() / shadow.sum()) ** 2

    grown = spread({"focal_spot": {"width_mm": 2.0, "length_mm": 0.0}}) - spread({})
    assert grown == pytest.approx(4 / 12, rel=0.005)


class CopperBall:
    """A ball at the isocenter with chords in closed form."""

    materials, energy_kev, threads = ("copper",), 60.0, 1

    def __init__(self, radius_mm):
        self.radius_mm, self.attenuation_per_mm = radius_mm, attenuation_per_mm("copper", [60.0])

    def chords(self, source, pixels):
        along = (pixels - source) / np.linalg.norm(pixels - source, axis=-1, keepdims=True)
        off = np.linalg.norm(np.cross(-source, along), axis=-1)
        return 2 * np.sqrt(np.maximum(self.radius_mm**2 - off**2, 0))

    def path_lengths(self, geometry, pose, motion_mm=None):
        """Path lengths of one view."""
        source = geometry.source_mm[0]
        u, v = geometry.column_positions_mm()[:, None], geometry.row_positions_mm()[:, None, None]
        pixels = geometry.detector_mm[0] + u * geometry.column_direction[0] + v * geometry.row_direction[0]
        return self.chords(source, pixels)[None, None]


def signal_under_a_spot(ball, geometry, width_mm, length_mm, anode_deg, points=24, rays=6):
    """Mean transmission [row, column] over points spread evenly over the anode and each pixel, by brute force.

    The source is at +y.
    """
    spot, within = ((np.arange(n) + 0.5) / n - 0.5 for n in (points, rays))
    radius, distance = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
    total = 0
    for dv, du in np.stack(np.meshgrid(within, within), axis=-1).reshape(-1, 2):
        u = geometry.column_positions_mm() + du * geometry.column_pitch_mm
        v = geometry.row_positions_mm() + dv * geometry.row_pitch_mm
        x, z = np.meshgrid(u, v)
        pixels = np.stack([x, np.full_like(x, radius - distance), z], axis=-1)
        for x, z in np.stack(np.meshgrid(width_mm * spot, length_mm * spot), axis=-1).reshape(-1, 2):
            source = np.array([x, radius - z / math.tan(math.radians(anode_deg)), z])
            total = total + np.exp(-ball.attenuation_per_mm[0] * ball.chords(source, pixels))
    return total / (points * rays) ** 2


@pytest.mark.parametrize(
    ("diameter_mm", "pitch_mm", "error"),
    # The distance of points equals the pixels; for a ball of that width, a ripple remains.
    [(0.5, 0.5, 0.06), (1.0, 0.5, 0.02), (1.0, 1.0, 0.03)],
)
def test_ball_under_a_focal_spot_wider_than_itself(diameter_mm, pitch_mm, error):
    """Copper under a spot of 2 mm by 2 mm: line integrals are positive and equal to those of a uniform spot.

    A rule of one line of points along either side, with a weight of -1/9 in the middle, gives -0.05 and twice the peak.
    """
    size = int(5 / pitch_mm) // 2 * 2 + 1
    geometry = circular(
        views=1,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=size,
        rows=size,
        column_pitch_mm=pitch_mm,
        row_pitch_mm=pitch_mm,
    )
    ball = CopperBall(diameter_mm / 2)
    found = Chain(ball, geometry, samples=6).state({"focal_spot": {"width_mm": 2.0, "length_mm": 2.0}})
    right = -np.log(signal_under_a_spot(ball, geometry, 2.0, 2.0, 12.0))
    assert found.line_integrals().min() > -1e-12
    assert np.abs(found.line_integrals()[0] - right).max() < error * right.max()
    assert found.line_integrals().sum() == pytest.approx(right.sum(), rel=0.02)


@pytest.mark.parametrize("sides", [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (30.0, 30.0)])
def test_points_of_the_spot_have_the_moments_of_its_rectangle(sides):
    """Moments of a uniform rectangle up to the fourth: 1/12 and 1/80 along either side, and their products."""
    state = State(GEOMETRY)
    load("focal_spot").apply(state, dict(zip(("width_mm", "length_mm"), sides, strict=True)))
    u, v, _, weight = np.array(state.sources).T
    assert weight.min() > 0
    moments = {0: 1.0, 1: 0.0, 2: 1 / 12, 3: 0.0, 4: 1 / 80}
    for one, other in itertools.product(moments, moments):
        right = moments[one] * sides[0] ** one * moments[other] * sides[1] ** other
        assert (weight * u**one * v**other).sum() == pytest.approx(right, abs=1e-12 * max(sides) ** (one + other))


def test_few_points_of_a_small_spot_have_its_mtf():
    """Up to the Nyquist frequency of the pixels, against the closed form of a uniform source."""
    places, weights = np.array(points(1.0, FEW_POINTS_PX, FEW_POINTS)).T
    cycles_per_px = np.linspace(0, 0.5, 11)
    found = np.cos(2 * np.pi * FEW_POINTS_PX * np.outer(cycles_per_px, places)) @ weights
    np.testing.assert_allclose(found, np.sinc(FEW_POINTS_PX * cycles_per_px), atol=0.0014)
    assert len(places) == FEW_POINTS
    assert len(points(1.0, 1.01 * FEW_POINTS_PX, FEW_POINTS)) == len(points(1.0, FEW_POINTS_PX)) == MIN_POINTS


def test_poses_of_a_disc_that_look_the_same_share_a_result():
    chain = Chain(DiscScene(100.0, "water"), GEOMETRY)
    first, turned, moved = (
        chain.transmission(GEOMETRY, pose) for pose in (Pose(), Pose(z_mm=3.0, turn_deg=5.0), Pose(x_mm=3.0))
    )
    assert turned is first and moved is not first


@pytest.mark.parametrize("angle", [10.0, -10.0])
def test_ends_of_a_long_spot_have_different_distances(angle):
    """Line focus: a spot of length l on an anode inclined by a is l / tan(a) deep.

    This blurs the shadow of an off-axis object along the columns by the variance of its position.
    """
    geometry = circular(
        views=1,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=1600,
        rows=1,
        column_pitch_mm=0.1,
        row_pitch_mm=1.0,
    )
    chain, u = Chain(DiscScene(4.0, "water"), geometry), geometry.column_positions_mm()
    aside = Pose(x_mm=35.0)

    def spread(physics):
        shadow = 1 - chain.state(physics, aside, anode=Anode("W", angle)).signal[0, 0]
        return (shadow * u**2).sum() / shadow.sum() - ((shadow * u).sum() / shadow.sum()) ** 2

    length = 2.0
    depth = length / math.tan(math.radians(angle))
    # The shadow is at x D / R; a source closer by s has it at x (D - s) / (R - s).
    slope = 35.0 * (1000.0 - 500.0) / 500.0**2
    grown = spread({"focal_spot": {"width_mm": 0.0, "length_mm": length}}) - spread({})
    assert grown == pytest.approx(slope**2 * depth**2 / 12, rel=0.02)
    state = State(geometry, anode=Anode("W", angle))
    load("focal_spot").apply(state, {"width_mm": 0.0, "length_mm": length})
    assert all(np.sign(row) == -np.sign(angle) * np.sign(away) for _, row, away, _ in state.sources)
    assert sum(weight for *_, weight in state.sources) == pytest.approx(1.0)


def test_points_of_the_spot_keep_the_detector_fixed():
    """Every pixel: if the source moved by rotation of the gantry, rays to the outer columns would end 0.6 mm off."""
    moved = displace_source(GEOMETRY, 3.0, -2.0, 1.5)
    for view, row, column in ((0, 0, 0), (7, 3, 40), (23, 5, 47)):
        source, pixel = GEOMETRY.ray(view, row, column)
        other_source, other_pixel = moved.ray(view, row, column)
        b = GEOMETRY.angles_rad[view]
        along, outwards = np.array([np.cos(b), np.sin(b), 0]), np.array([-np.sin(b), np.cos(b), 0])
        np.testing.assert_allclose(other_source, source + 3 * along + [0, 0, -2] + 1.5 * outwards, atol=1e-9)
        np.testing.assert_allclose(other_pixel, pixel, atol=1e-9)


def test_crosstalk_conserves_the_signal():
    delta = np.zeros((5, 5, 5))
    delta[2, 2, 2] = 1
    found = with_afterglow(with_crosstalk(delta, (0.1, 0.05)), (0.2, 0.0, 1.0))
    assert found.sum() == pytest.approx(1)
    assert found[2, 2, 3] == pytest.approx(0.1 * 0.9 * 0.8) and found[3, 2, 2] == pytest.approx(0.8 * 0.9 * 0.2)
    assert with_afterglow(with_crosstalk(np.ones((3, 4, 5)), (0.1, 0.1)), (0.1, 0.3, 1.0)) == pytest.approx(1)


def sharing_matrix(weights, length):
    """Shares [to, from] of pixels for weights by distance; the axis is mirrored at both edges."""
    matrix = np.zeros((length, length))
    for pixel in range(length):
        for apart in range(1 - len(weights), len(weights)):
            far = (pixel + apart) % (2 * length)
            matrix[pixel, min(far, 2 * length - 1 - far)] += weights[abs(apart)]
    return matrix


@pytest.mark.parametrize(("c", "q", "length"), [(0.1, 0.3, 30), (0.2, 0.5, 60), (0.1, 0.4, 5), (0.2, 0.5, 2)])
def test_tail_of_crosstalk_decays_geometrically(c, q, length):
    """Shares c (1 - q) q^(n - 1), of which the last includes all further pixels, also as variance and covariance."""
    sharing = Sharing.of(c, q, length)
    reach = len(sharing.weights) - 1
    sides = [c * (1 - q) * q**n for n in range(reach - 1)]
    np.testing.assert_allclose(sharing.weights, [1 - 2 * c, *sides, c - sum(sides)], rtol=1e-9)
    assert reach == length // 2 or 1e-6 > q**reach > 1e-7
    matrix = sharing_matrix(sharing.weights, length)
    random = np.random.default_rng(2)
    signal = random.uniform(0.1, 1, (3, 4, length))
    found = [with_crosstalk(signal, (c, 0.0), q, squared) for squared in (False, True)]
    np.testing.assert_allclose(found[0], signal @ matrix.T, rtol=1e-12)
    covariance = np.einsum("ik,vrk,jk->vrij", matrix, signal, matrix)
    np.testing.assert_allclose(found[1], np.einsum("vrii->vri", covariance), rtol=1e-12)
    pixel = np.arange(length - 1)
    neighbors = sharing.between_neighbors(signal, 2)
    np.testing.assert_allclose(neighbors, covariance[..., pixel, pixel + 1], rtol=1e-12)
    # Along rows as along columns.
    turned = with_crosstalk(signal.swapaxes(1, 2), (0.0, c), q)
    np.testing.assert_array_equal(turned.swapaxes(1, 2), found[0])
    np.testing.assert_array_equal(sharing.between_neighbors(signal.swapaxes(1, 2), 1).swapaxes(1, 2), neighbors)


def test_correlations_of_a_tail_equal_their_closed_form():
    """Sums of products of the weights m = 1 - 2c and a q^(n - 1), a = c (1 - q), over the sum of their squares."""
    c, q = 0.1, 0.3
    a, m = c * (1 - q), 1 - 2 * c
    square = m**2 + 2 * a**2 / (1 - q**2)
    right = [2 * a * (m + a * q / (1 - q**2)), a * (2 * m * q + a * (1 + 2 * q**2 / (1 - q**2)))]
    np.testing.assert_allclose(Sharing.of(c, q, 100).correlations[:2], np.array(right) / square, rtol=1e-6)


@pytest.mark.parametrize("name", ["xray_crosstalk", "optical_crosstalk"])
def test_crosstalk_without_a_tail_reaches_the_next_pixel_only(chain, name):
    """Settings without the tail are those with a tail of 0."""
    without, zero, tail = (
        chain.state({name: {"column": 0.1, "row": 0.05} | more}) for more in ({}, {"tail": 0.0}, {"tail": 0.3})
    )
    for part in ("line_integrals", "variance"):
        np.testing.assert_array_equal(getattr(without, part)(), getattr(zero, part)())
        assert (getattr(tail, part)() != getattr(zero, part)()).any()
    np.testing.assert_array_equal(correlations(without), correlations(zero))
    assert checked({name: {"column": 0.1}})[name]["tail"] == 0
    np.testing.assert_array_equal(Sharing.of(0.1, 0.0, 48).weights, [0.8, 0.1])


def test_afterglow_decays_by_its_memory():
    """One bright view: k (1 - d) d^(j - 1) of it j views later; without afterglow before, 1 - k of the first view."""
    bright = np.zeros((6, 1, 1))
    bright[1] = 1
    k, d = 0.2, 0.6
    expected = [0, 1 - k, *(k * (1 - d) * d**j for j in range(4))]
    np.testing.assert_allclose(with_afterglow(bright, (k, d, 0.0))[:, 0, 0], expected)
    np.testing.assert_allclose(with_afterglow(np.ones((2, 1, 1)), (k, d, 0.0))[:, 0, 0], [1 - k, 1 - k + k * (1 - d)])
    np.testing.assert_allclose(with_afterglow(bright, (k, d, 0.0), squared=True)[:, 0, 0], np.square(expected))


def test_long_afterglow_has_the_variance_and_correlation_of_its_weights(chain):
    state = chain.state({"afterglow": {"share": 0.3, "time_constant_ms": 30.0, "before": 1.0}})
    share, memory, _ = state.lag
    weights = np.array([1 - share, *(share * (1 - memory) * memory**j for j in range(60))])
    whole = with_afterglow(np.ones((200, 1, 1)), state.lag, squared=True)[-1, 0, 0]
    assert whole == pytest.approx((weights**2).sum())
    signal = np.ones((400, 1, 1))
    lasting = State(GEOMETRY, signal=signal, air=signal[:1], lag=state.lag)
    right = (weights[1:] * weights[:-1]).sum() / (weights**2).sum()
    # The noise of views before the scan is averaged and uncorrelated with the scan's.
    assert correlations(lasting)[2] == pytest.approx(right, rel=0.01)


def test_afterglow_from_before_the_scan_has_the_noise_of_its_views(chain):
    state = chain.state({"afterglow": {"share": 0.3, "time_constant_ms": 200.0, "before": 1.0}})
    scans = noisy_lines(state, 60, np.random.default_rng(8))
    ratio = (scans.var(axis=0, ddof=1) / state.variance()).mean(axis=(1, 2))
    pixels = state.signal[0].size
    assert np.abs(ratio - 1).max() < 5 * math.sqrt(2 / 59 / pixels)


@pytest.mark.parametrize(("counts", "electronic"), [(20.0, 0.0), (100.0, 0.0), (300.0, 60.0), (60.0, 10.0)])
def test_moments_of_the_logarithm_of_few_noisy_counts(counts, electronic):
    """Against a million realizations, from which first-order moments differ more than twice as much."""
    one = np.ones((1, 1, 1))
    state = State(GEOMETRY, photons=counts, signal=one, air=one, electronic=electronic)
    random = np.random.default_rng(7)
    drawn = random.poisson(counts, 1_000_000) + electronic * random.normal(size=1_000_000)
    lines = -np.log(np.maximum(drawn, 0.5) / counts)
    above, variance = (float(moment[0, 0, 0]) for moment in state.log_noise())
    first = float(state.variance()[0, 0, 0])
    assert abs(lines.var() - variance) < 0.4 * abs(lines.var() - first)
    assert abs(lines.mean() - above) < 0.4 * abs(lines.mean() - first / 2)


def noise_of(chain, physics, repeats=40, seed=3):
    state = chain.state(physics)
    return state, noisy_lines(state, repeats, np.random.default_rng(seed))


@pytest.mark.parametrize(
    "name",
    ["electronic_noise", "optical_crosstalk", "afterglow", "bowtie", "current_modulation", "detector_saturation"],
)
def test_simulated_noise_follows_the_model(chain, name):
    state, scans = noise_of(chain, {name: load(name).values({})})
    ratio = scans.var(axis=0, ddof=1) / state.variance()
    assert ratio.mean() == pytest.approx(1, abs=4 * math.sqrt(2 / 39 / ratio.size))
    flat = (scans - scans.mean(axis=0)) / np.sqrt(state.variance())
    uniform = state.signal / state.air > 0.99  # rays through the object: neighbors have similar signals
    for axis, right in zip((3, 2, 1), correlations(state), strict=True):
        both = np.take(uniform, range(1, uniform.shape[axis - 1]), axis - 1)
        both &= np.take(uniform, range(uniform.shape[axis - 1] - 1), axis - 1)
        products = np.take(flat, range(1, flat.shape[axis]), axis) * np.take(flat, range(flat.shape[axis] - 1), axis)
        found = products[:, both].mean() * 40 / 39
        assert found == pytest.approx(right, abs=5 / math.sqrt(40 * both.sum()) + 0.01 * (right > 0)), axis


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("optical_crosstalk", {"column": 0.03, "row": 0.03}),
        ("optical_crosstalk", {"column": 0.1, "row": 0.05, "tail": 0.4}),
        ("afterglow", {"share": 0.3, "time_constant_ms": 20.0, "before": 1.0}),
    ],
)
def test_electronic_noise_reduces_correlations(chain, name, values):
    """Over the whole scan, with the weights of `observe`: with few photons, most of the noise is white."""
    physics = {name: values, "electronic_noise": {"photons": 200.0}}
    state, scans = noise_of(chain, physics)
    reference = state.variance() * np.linspace(0.5, 2, GEOMETRY.columns)
    usable = np.ones(reference.shape, bool)
    found = observe(Scans(scans.astype(np.float32), None, usable), reference)
    undiluted = correlations(chain.state({name: physics[name]}))
    for place, right in enumerate(correlations(state, 1 / reference)):
        assert abs(found.correlation[place] - right) < 4 * found.correlation_error[place] + 0.02 * right
        if undiluted[place] > 0:  # by 9.4 standard errors for afterglow, and more for crosstalk
            assert undiluted[place] - found.correlation[place] > 5 * found.correlation_error[place]


def test_dark_signal_drifts_about_the_middle_of_the_scan(chain):
    """Each view at the middle of its interval, so that the mean over the scan is the level: 2 % of 200 000 photons."""
    state = chain.state({"dark_signal": {"level_units": 4000.0, "drift_units_per_s": 10000.0}})
    added = (state.measured - chain.state({}).measured)[:, 0, 0]
    views = GEOMETRY.views
    np.testing.assert_allclose(added * 2e5, 4000 + 10000 * (np.arange(views) + 0.5 - views / 2) * 0.02, atol=1e-6)


def test_fluence_and_gain(chain):
    waves = chain.state({"current_modulation": {"cosine": 0.4, "sine": 0.0}}).air[:, 0, 0]
    assert waves[0] == pytest.approx(1.4) and waves[6] == pytest.approx(0.6)
    pattern = chain.state({"gain_pattern": {"rms": 0.01, "detector": 4.0}})
    constant = pattern.line_integrals() - chain.state({}).line_integrals()
    assert np.ptp(constant, axis=0).max() < 1e-9 and constant[0].std() == pytest.approx(0.01, rel=0.15)
    assert chain.state({"photon_flux": {"factor": 0.5}}).photons == 1e5


def test_gain_pattern_multiplies_the_gain_of_another_effect(chain):
    pattern = {"gain_pattern": {"rms": 0.01, "detector": 4.0}}
    drift = np.linspace(0.9, 1.1, GEOMETRY.views)[:, None, None]
    both = chain.state(pattern, gain=drift).line_integrals() - chain.state(pattern).line_integrals()
    np.testing.assert_allclose(both, np.broadcast_to(-np.log(drift), both.shape), atol=1e-12)


def test_geometry_errors_move_the_shadow_of_a_disc():
    """Positions of a thin disc's shadow: u = D t/(R - depth towards the source)."""
    geometry = circular(
        views=4,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=801,
        rows=1,
        column_pitch_mm=0.25,
        row_pitch_mm=1.0,
        view_interval_ms=500.0,
    )
    chain = Chain(DiscScene(3.0, "water"), geometry)
    u = geometry.column_positions_mm()

    def centres(physics, pose):
        shadow = 1 - chain.state(physics, pose).signal[:, 0]
        return (shadow * u).sum(axis=1) / shadow.sum(axis=1)

    # source at +y, -x, -y, +x; columns along +x, +y, -x, -y
    right = [1000 * t / (500 - depth) for t, depth in ((10, 20), (20, -10), (-10, -20), (-20, 10))]
    np.testing.assert_allclose(centres({}, Pose(10, 20)), right, atol=0.02)
    np.testing.assert_allclose(
        centres({"detector_offset": {"columns_px": 2.0}}, Pose(10, 20)), np.array(right) - 0.5, atol=0.02
    )
    right = [1000 * (t + 1) / (500 - depth) for t, depth in ((10, 20), (20, -10), (-10, -20), (-20, 10))]
    np.testing.assert_allclose(centres({"centre_of_rotation": {"shift_mm": 1.0}}, Pose(10, 20)), right, atol=0.02)
    right = [1010 * t / (505 - depth) for t, depth in ((10, 20), (20, -10), (-10, -20), (-20, 10))]
    far = {"source_distance": {"isocentre_mm": 5.0, "detector_mm": 10.0}}
    np.testing.assert_allclose(centres(far, Pose(10, 20)), right, atol=0.02)
    # each of four views in the middle of its quarter of the scan
    drift = np.array([-3 / 8, -1 / 8, 1 / 8, 3 / 8]) * 6
    right = [
        1000 * t / (500 - d)
        for t, d in ((10 + drift[0], 20), (20, -10 - drift[1]), (-10 - drift[2], -20), (-20, 10 + drift[3]))
    ]
    moved = {"motion": load("motion").values({"x_mm_per_s": 3.0})}
    np.testing.assert_allclose(centres(moved, Pose(10, 20)), right, atol=0.02)


def test_disc_of_voxels_and_disc_in_closed_form_agree():
    grid = Grid((20, 300, 300), (4.0, 0.25, 0.25))
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij", sparse=True)
    voxels = ((x**2 + y**2 + 0 * z) < 30**2).astype(np.float32)[None]
    motion = np.random.default_rng(0).normal(size=(24, 3)) * [2, 2, 0]
    pose = Pose(3.0, -5.0, 0.0, 12.0, 1.02)
    scenes = DiscScene(60.0, "water"), VoxelScene(voxels, grid, ("water",), 60.0)
    for moved in (None, motion):
        one, other = (scene.path_lengths(GEOMETRY, pose, moved)[0, :, 2:4] for scene in scenes)
        # a rotation about the isocenter moves an off-axis disc; motion of the object is in fixed coordinates
        assert np.abs(one - other).mean() < 0.1 and np.quantile(np.abs(one - other), 0.9) < 0.3


def test_effects_on_images():
    spacing = (2.0, 1.0, 0.5)
    point = np.zeros((31, 41, 61))
    point[15, 20, 30] = 1000
    axes = [(np.arange(n) - n // 2) * step for n, step in zip(point.shape, spacing, strict=True)]

    def spreads(image):
        share = image / image.sum()
        return [(share.sum(axis=tuple({0, 1, 2} - {k})) * axis**2).sum() for k, axis in enumerate(axes)]

    def applied(physics):
        return apply_image_effects(point, spacing, checked(physics))

    blurred = applied({"reconstruction_kernel": {"sigma_mm": 1.5}})
    assert spreads(blurred) == pytest.approx([0, 1.5**2, 1.5**2], rel=0.01, abs=1e-6)
    narrow = applied({"reconstruction_kernel": {"sigma_mm": 0.2}})  # below half a voxel
    assert spreads(narrow) == pytest.approx([0, 0.2**2, 0.2**2], rel=0.01, abs=1e-6)
    thick = applied({"slice_thickness": {"thickness_mm": 10.0}})
    np.testing.assert_allclose(thick[:, 20, 30][12:19], [0, 200, 200, 200, 200, 200, 0], atol=1e-3)
    between = applied({"slice_thickness": {"thickness_mm": 4.0}})
    np.testing.assert_allclose(between[14:17, 20, 30], [250, 500, 250], atol=1e-3)
    assert applied({}) is point
    both = {"hu_calibration": {"scale": 1.1, "offset_hu": -7.0}, "reconstruction_kernel": {"sigma_mm": 0.0}}
    np.testing.assert_allclose(applied(both), 1.1 * point - 7, rtol=1e-6)
    for name, neutral in (
        ("slice_thickness", {"thickness_mm": 0.0}),
        ("hu_calibration", {"scale": 1.0, "offset_hu": 0.0}),
    ):
        np.testing.assert_array_equal(applied({name: neutral}), point)


def test_dark_signal_is_read_without_noise_of_its_own():
    """It shifts the readings and thus reduces the relative noise."""
    photons, level = 2e4, 0.05
    chain = Chain(DiscScene(160.0, "water"), GEOMETRY, photons)
    plain, dark = (
        chain.state({}),
        chain.state({"dark_signal": {"level_units": level * photons, "drift_units_per_s": 0.0}}),
    )
    first, second = (state.counts(np.random.default_rng(1)) for state in (plain, dark))
    np.testing.assert_allclose(second - first, level * photons, rtol=1e-9)
    np.testing.assert_allclose(dark.variance(), plain.variance() * (plain.measured / dark.measured) ** 2)
    lines = np.stack([-np.log(dark.counts(np.random.default_rng(seed)) / (1.05 * photons)) for seed in range(60)])
    ratio = (lines.var(axis=0, ddof=1) / dark.variance()).mean()
    assert ratio == pytest.approx(1, abs=0.01 + 4 * np.sqrt(2 / 59 / dark.variance().size))
