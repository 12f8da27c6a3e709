import numpy as np
import pandas as pd
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.names import FEATURES
from virtual_phantom.statistics import measured, roi_profiles


def profile(**columns):
    return pd.DataFrame(columns, index=list("abcd"), dtype=float)


def test_order_and_distance_of_simple_values():
    truth = profile(up=[1, 2, 3, 4], down=[1, 2, 3, 4], same=[5, 5, 5, 5], swapped=[1, 2, 3, 4])
    found = roi_profiles.compare_profiles(
        profile(up=[10, 20, 30, 40], down=[4, 3, 2, 1], same=[1, 2, 3, 4], swapped=[1, 2, 4, 3]), truth
    )
    # Two swapped neighbors of four: 1 - 6 x 2 / (4 x 15) = 0.8. SD of 1 2 3 4: sqrt(5 / 3).
    assert found["order"].tolist() == pytest.approx([1, -1, 0, 0.8])
    assert found["distance"].tolist() == pytest.approx(
        [22.5 / np.sqrt(5 / 3), 2 / np.sqrt(5 / 3), np.inf, 0.5 / np.sqrt(5 / 3)]
    )
    assert (roi_profiles.compare_profiles(truth[["up", "swapped"]], truth)["distance"] == 0).all()


def test_only_common_features_are_compared():
    truth = profile(x=[1, 2, 3, 4], y=[1, 2, 3, 4])
    assert list(roi_profiles.compare_profiles(truth[["y"]].iloc[::-1], truth)["order"]) == [pytest.approx(1)]
    with pytest.raises(InputError, match="2 ROIs and 2 features in common"):
        roi_profiles.compare_profiles(truth.iloc[:2], truth)
    with pytest.raises(InputError, match="4 ROIs and 0 features in common"):
        roi_profiles.compare_profiles(truth.rename(columns={"x": "z", "y": "w"}), truth)


def test_another_reconstruction_of_the_same_scans_orders_rois_equally():
    """Two reconstructions of the printed phantom at 10 mGy, as an ideal simulation would be."""
    rows = measured.load_dose_series().query("dose_mgy == 10")
    one, other = (
        part.pivot(index="roi", columns="feature", values="mean")[list(FEATURES)]
        for _, part in rows.groupby("reconstruction")
    )
    order = roi_profiles.compare_profiles(one, other)["order"]
    # With six ROIs and at most one adjacent pair swapped, the coefficient is at least 0.94.
    assert order.mean() > 0.9 and (order >= 0.9).mean() > 0.85
    # The same values of each feature, assigned to ROIs at random: no agreement remains.
    rng = np.random.default_rng(2)
    mixed = other.apply(lambda column: rng.permutation(column.to_numpy()))
    assert abs(roi_profiles.compare_profiles(one, mixed)["order"].mean()) < 4 / np.sqrt(5 * 86)
