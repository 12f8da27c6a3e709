"""Random fields against the moments and autocorrelation of their definition."""

import numpy as np
import pytest
from scipy.stats import kurtosis, skew

from virtual_phantom.base import streams
from virtual_phantom.phantom.shapes import Ellipsoid
from virtual_phantom.phantom.texture import Component, Field, Texture, lognormal_shape

SEED = np.random.SeedSequence(7)


def test_field_has_its_moments_and_autocorrelation():
    field = Field(Component(sd_hu=10, correlation_mm=2.0), SEED)
    axis = np.arange(0, 96, 1.0)  # one period: 48 correlation lengths
    values = field.sample(axis, axis, axis)
    assert values.std() == pytest.approx(10, rel=0.02)
    assert abs(values.mean()) < 0.3
    assert skew(values.ravel()) == pytest.approx(0, abs=0.1)
    for lag in (1, 2, 4):
        measured = (values * np.roll(values, lag, axis=2)).mean() / values.var()
        assert measured == pytest.approx(np.exp(-(lag**2) / 8), abs=0.03)


@pytest.mark.parametrize("skewness", [1.6, 0.6, -1.0])
def test_point_transform_gives_skewness(skewness):
    field = Field(Component(1.0, 1.0, skewness), SEED)
    axis = np.arange(0, 48, 0.5)
    values = field.sample(axis, axis, axis)
    assert skew(values.ravel()) == pytest.approx(skewness, rel=0.12)
    assert (values.mean(), values.std()) == pytest.approx((0, 1), abs=0.03)
    assert kurtosis(values.ravel()) > 0.2


def test_lognormal_shape_has_a_tabulated_skewness():
    # the standard lognormal (s = 1) has skewness (e + 2) sqrt(e - 1) = 6.1849; s = 0.5 has 1.7502
    assert lognormal_shape(1.7502) == pytest.approx(0.5, abs=1e-4)
    assert lognormal_shape(0.0) == 0.0


def test_same_position_has_the_same_value_on_any_axes():
    texture = Texture((Component(10, 2, 1), Component(5, 4)), "liver", SEED)
    coarse, fine = np.arange(-30, 30, 3.0), np.arange(-30, 30, 0.75)
    np.testing.assert_allclose(
        texture.sample(fine, fine, fine)[::4, ::4, ::4], texture.sample(coarse, coarse, coarse), atol=1e-4
    )
    np.testing.assert_allclose(
        texture.sample(coarse[3:5], coarse, coarse[:7]),
        texture.sample(coarse, coarse, coarse)[3:5, :, :7],
        atol=1e-4,
    )


def test_each_name_has_its_own_stream_in_any_order():
    draw = lambda s: np.random.default_rng(s).random()  # noqa: E731
    assert draw(streams.named(SEED, "liver", 0)) == draw(streams.named(SEED, "liver", 0))
    draws = {draw(streams.named(SEED, *names)) for names in (("liver", 0), ("liver", 1), ("spleen", 0))}
    assert len(draws) == 3
    assert draw(streams.named(np.random.SeedSequence(8), "liver", 0)) not in draws


@pytest.mark.parametrize("seed", range(3))
def test_conditioning_gives_a_small_region_its_mean_and_sd_at_every_seed(seed):
    region = Ellipsoid((5, -3, 2), (8, 9, 5))
    texture = Texture((Component(12, 2.5, 1.2),), "hem", np.random.SeedSequence(seed))
    texture.condition(region)
    z, y, x = np.arange(-4, 8, 0.5), np.arange(-13, 7, 0.5), np.arange(-4, 14, 0.5)
    inside = texture.sample(z, y, x)[region.level(*np.ix_(z, y, x)) < 0]
    assert inside.mean() == pytest.approx(0, abs=0.2)
    assert inside.std() == pytest.approx(12, rel=0.02)


@pytest.mark.parametrize("arguments", [(-1, 2), (1, 0), (1, 2, 9)])
def test_impossible_components_are_rejected(arguments):
    with pytest.raises(ValueError):
        Component(*arguments)
