import numpy as np
import pytest

from virtual_phantom.statistics import agreement_measures as measures

# Shrout and Fleiss (Psychol. Bull. 86, 420, 1979), Table 2: six targets (rows), four judges.
SHROUT_FLEISS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float
)[..., None]


def values(icc):
    return [float(part) for part in (icc.value, icc.low, icc.high)]


def test_mean_squares_equal_published_ones():
    # Their Table 3: between targets 11.24, between judges 32.49, residual 1.02.
    assert np.round(measures.mean_squares(SHROUT_FLEISS), 2).tolist() == [11.24, 32.49, 1.02]


def test_icc_equals_published_values():
    # Values: their Table 4. Intervals: as the R package psych prints them for its function ICC on these data.
    assert values(measures.icc_agreement(SHROUT_FLEISS)) == pytest.approx([0.29, 0.019, 0.76], abs=0.005)
    assert values(measures.icc_consistency(SHROUT_FLEISS)) == pytest.approx([0.71, 0.342, 0.95], abs=0.005)


def test_duplicate_repeats_change_nothing_and_features_are_separate():
    twice = np.repeat(SHROUT_FLEISS, 2, axis=-1)
    assert values(measures.icc_agreement(twice)) == pytest.approx(values(measures.icc_agreement(SHROUT_FLEISS)))
    both = measures.icc_consistency(np.stack([twice, twice[::-1] ** 2]))
    assert both.value.tolist() == pytest.approx([float(measures.icc_consistency(x).value) for x in (twice, twice**2)])


def test_icc_recovers_known_shares_of_variance():
    rng = np.random.default_rng(7)

    def drawn(sd, *shape):
        values = rng.normal(size=shape)
        return sd * (values - values.mean()) / values.std(ddof=1)

    x = drawn(2, 500, 1, 1) + drawn(1.5, 1, 200, 1) + drawn(1, 500, 200, 2)
    assert float(measures.icc_agreement(x).value) == pytest.approx(4 / (4 + 2.25 + 1), abs=0.005)
    assert float(measures.icc_consistency(x).value) == pytest.approx(4 / (4 + 1), abs=0.005)


def test_icc_intervals_have_their_coverage():
    rng = np.random.default_rng(1)
    x = rng.normal(0, 1, (4000, 6, 1, 1)) + rng.normal(0, 1, (4000, 1, 8, 1)) + rng.normal(0, 1, (4000, 6, 8, 1))
    for icc, truth in ((measures.icc_agreement(x), 1 / 3), (measures.icc_consistency(x), 1 / 2)):
        assert ((icc.low <= truth) & (truth <= icc.high)).mean() == pytest.approx(0.95, abs=0.02)


def test_shift_between_conditions_reduces_agreement_and_not_consistency():
    x = np.array([[1.0, 11], [2, 12], [4, 14]])[..., None]
    assert values(measures.icc_consistency(x)) == [1, 1, 1]
    assert float(measures.icc_agreement(x).value) < 0.1


@pytest.mark.filterwarnings("error")
def test_measures_without_variance_are_undefined():
    x = np.full((3, 4, 2), 0.1)
    for icc in (measures.icc_agreement(x), measures.icc_consistency(x)):
        assert np.isnan(values(icc)).all()
    assert np.isnan(measures.concordance(x))
    assert measures.coefficient_of_variation(x) == pytest.approx(0) and measures.quartile_dispersion(x) == 0


def test_concordance_of_simple_values():
    # Variances and covariance 2/3, means 1 apart: 2 (2/3) / (4/3 + 1) = 4/7; with itself 1.
    a = np.array([1.0, 2, 3])
    assert measures.concordance(np.stack([a, a + 1], axis=1)[..., None]) == pytest.approx(4 / 7)
    assert measures.concordance(np.stack([a, a, a + 1], axis=1)[..., None]) == pytest.approx((1 + 2 * 4 / 7) / 3)
    # Repeats are further pairs: one subject's three repeats equal the three subjects above.
    assert measures.concordance(np.stack([a, a + 1])[None]) == pytest.approx(4 / 7)
    assert measures.concordance(np.stack([a, -a], axis=1)[..., None]) == pytest.approx(-(4 / 3) / (4 / 3 + 16))


def test_variation_of_simple_values():
    # SD sqrt(2) of mean 10, and zero: root mean square sqrt(0.02 / 2) = 0.1. The sign has no effect.
    x = np.array([[[9.0], [11]], [[20], [20]]])
    assert measures.coefficient_of_variation(x) == pytest.approx(0.1)
    assert measures.coefficient_of_variation(-x) == pytest.approx(0.1)


def test_quartile_dispersion_of_simple_values():
    # Quartiles 2 and 4 of 1 to 5: 2 / 6 in any unit; 0 of the constant subject; the median of the three.
    row = np.arange(1.0, 6)
    x = np.stack([row, 2 * row, np.full(5, 7.0)])[:, None, :]
    assert measures.quartile_dispersion(x) == pytest.approx(1 / 3)
    assert measures.quartile_dispersion(-x) == pytest.approx(1 / 3)


def test_relative_spread_of_values_that_change_sign_is_undefined():
    x = np.array([[[1.0, 2]], [[-1, 3]]])
    assert np.isnan(measures.coefficient_of_variation(x)) and np.isnan(measures.quartile_dispersion(x))
    assert np.isnan(measures.coefficient_of_variation(np.array([[[0.0, 2]], [[1, 3]]])))
