"""Separability of effects in known cases: a centered disc, closed forms, and hand-made vectors."""

import csv

import numpy as np
import pytest
from generators import effect_templates
from generators.effect_templates import (
    Template,
    absorbed_in_range,
    correlations,
    grouped,
    shares_of_parts,
    split,
    templates_of_effects,
)

from virtual_phantom.base.geometry import circular
from virtual_phantom.base.names import label
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.templates import data_changes, projected
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, applicable_effects, names
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.projections import Projections

PHOTONS = 1e5
GEOMETRY = circular(
    views=24,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=1000.0,
    columns=60,
    rows=4,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
    view_interval_ms=10.0,
)


def ready(**known):
    chain = Chain(DiscScene(160.0, "water"), GEOMETRY, PHOTONS, samples=6)
    state, random = chain.state({}), np.random.default_rng(5)
    white = state.measured_air[0] * PHOTONS
    taken = [Projections(state.counts(random), white, np.zeros_like(white)) for _ in range(8)]
    prepared_data = prepared.prepare(observed.scans(taken), None, chain, nominal_photons=PHOTONS, known=known)
    return prepared_data.fitter, prepared_data.fitter.fit(())


@pytest.fixture(scope="module")
def disc():
    """The disc has a known size, so that symmetric changes are not absorbed by asymmetric ones."""
    return ready(size=1e-9)


def test_noise_has_no_share_in_the_mean_and_flux_has_its_closed_form(disc):
    fitter, fit = disc
    quiet = ("electronic_noise", "current_modulation", "photon_flux", "heel", "bowtie")
    for one in templates_of_effects(fitter, fit, quiet):
        found = shares_of_parts(fitter, one.change)
        assert found["mean"] < 1e-3 and sum(found.values()) == pytest.approx(1)
        assert (found["white field"] > 0.01) == (one.effect in ("heel", "bowtie"))
    (flux,) = templates_of_effects(fitter, fit, ["photon_flux"])
    # With 0.7 of the m photons: the variance of the logarithm is 1/m + 3/(2 m^2), in every block.
    data = fitter.data
    inverse = fitter.model.predict({}, fit.nuisance, data).state.variance()
    now, fewer = (data.blocks.sum((v + 1.5 * v**2) / data.reference) for v in (inverse, inverse / 0.7))
    expected = (np.log(fewer / now) ** 2) @ fitter.weights[1]
    part = split(fitter, flux.change)["noise variance"]
    assert part @ part == pytest.approx(expected, rel=1e-6)


def test_flux_is_measured_through_its_declaration_only(disc):
    fitter, fit = disc
    (flux,) = templates_of_effects(fitter, fit, ["photon_flux"])
    # One parameter with a prior of 2 %, plus the information in the variances of the blocks.
    data, known = fitter.weights[1].sum(), 1 / 0.02**2
    assert flux.absorbed == pytest.approx(data / (data + known), rel=1e-3)
    unstated = np.linalg.qr(data_changes(Problem(fitter, (), fit)))[0]
    left = projected(flux.change[None], unstated)[0]
    assert left @ left < 1e-5 * (flux.change @ flux.change)


def test_centered_disc_does_not_distinguish_detector_offset_from_axis_offset(disc):
    found = templates_of_effects(*disc, ("detector_offset", "centre_of_rotation", "scatter", "optical_crosstalk"))
    correlation = correlations(found)
    np.testing.assert_allclose(np.diag(correlation), 1)
    np.testing.assert_allclose(correlation, correlation.T)
    # A shift of the object along the columns moves its shadow opposite to the detector, by the same amount to first
    # order.
    assert correlation[0, 1] < -0.95 and abs(correlation[0, 2]) < 0.05


def test_crosstalk_of_light_and_of_x_rays_differ_in_noise(disc):
    fitter, fit = disc
    xray, light = (templates_of_effects(fitter, fit, [name])[0] for name in ("xray_crosstalk", "optical_crosstalk"))
    means = [split(fitter, one.change)["mean"] for one in (xray, light)]
    assert means[0] @ means[1] > 0.999 * np.linalg.norm(means[0]) * np.linalg.norm(means[1])
    assert shares_of_parts(fitter, xray.change)["noise correlation"] == 0
    # (c, 1 - 2c, c) with c = 0.03 as a matrix that conserves the signal at edges. Its square is the covariance of a
    # uniform signal. Columns at the disc's edges differ slightly.
    columns = fitter.data.mean.shape[2]
    share = 0.03 * (np.eye(columns, k=1) + np.eye(columns, k=-1))
    covariance = np.linalg.matrix_power(share + np.diag(1 - share.sum(axis=0)), 2)
    correlation = np.diag(covariance, 1).mean() / np.diag(covariance).mean()
    expected = correlation * np.sqrt(fitter.weights[2][0])
    assert split(fitter, light.change)["noise correlation"][0] == pytest.approx(expected, rel=0.01)


def test_free_density_scale_absorbs_more_scatter_than_a_fixed_one():
    found = []
    for fitter, fit in (ready(scale=0.001, offset=0.001), ready(scale=1.0, offset=1.0)):
        (scatter,) = templates_of_effects(fitter, fit, ["scatter"])
        found.append(absorbed_in_range(fitter, fit, scatter.change[None])[0])
        assert found[-1] <= scatter.absorbed + 1e-9
    held_out, free = found
    assert held_out < free - 0.02 and free == pytest.approx(scatter.absorbed, abs=1e-6)


def test_change_outside_the_prior_range_is_not_absorbed(disc):
    fitter, fit = disc
    problem = Problem(fitter, (), fit)
    place = len(problem.unknowns) + [one.name for one in problem.nuisances].index("scale")
    column = data_changes(problem)[:, place]
    margin = problem.high[place] - problem.start[place]
    found = absorbed_in_range(fitter, fit, np.stack([0.5 * margin * column, 100 * margin * column]))
    # All within the range, little far beyond it.
    assert found[0] > 0.999 and found[1] < 0.1


def test_gain_pattern_is_that_of_its_realization(disc):
    fitter, fit = disc
    (one,) = templates_of_effects(fitter, fit, ["gain_pattern"])
    mean = split(fitter, one.change)["mean"].reshape(fitter.data.mean.shape) / np.sqrt(
        fitter.weights[0].reshape(fitter.data.mean.shape)
    )
    np.testing.assert_allclose(mean, np.broadcast_to(mean[0], mean.shape), atol=1e-9)
    assert mean[0].std() == pytest.approx(0.005, rel=0.2)  # 240 normal random numbers


def test_cosines_and_groups_of_simple_vectors():
    vectors = {"a": [1.0, 0, 0, 0], "c": [0, 0, 2.0, 0], "b": [1.0, 1, 0, 0], "d": [0, 0, -3.0, 0.3], "none": [0.0] * 4}
    found = [Template(name, None, np.ones(4), np.array(left)) for name, left in vectors.items()]
    correlation = correlations(found)
    assert correlation[0, 2] == pytest.approx(np.sqrt(0.5))
    assert correlation[1, 3] == pytest.approx(-3 / np.hypot(3, 0.3))
    assert np.isnan(correlation[4]).all()
    order = grouped(correlation)
    assert sorted(order) == list(range(5))
    assert abs(order.index(1) - order.index(3)) == 1 and abs(order.index(0) - order.index(2)) == 1


def test_projection_keeps_the_orthogonal_part():
    basis = np.linalg.qr(np.array([[1.0, 0], [1, 0], [0, 1], [0, 0], [1, 1]]))[0]
    rows = np.array([[1.0, 1, 0, 0], [1, -1, 0, 2]])
    left = projected(rows, basis)
    assert left.shape == (2, 5)
    np.testing.assert_allclose(left @ basis, 0, atol=1e-12)
    np.testing.assert_allclose(left[1], [1, -1, 0, 2, 0], atol=1e-12)


def test_page_lists_every_effect_on_projections():
    with effect_templates.TABLE.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    listed = {row[0].split(":")[0] for row in rows}
    labels = {label(name) for name in applicable_effects(names(), ()) if not acts_on_images(name)}
    assert listed == labels, "run python docs/generators/effect_templates.py"
    assert all(len(row) == len(header) == 7 for row in rows)
