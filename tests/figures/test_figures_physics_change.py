"""Figure of stability with physics against stability without: changes are numbered, named and visible."""

import numpy as np
import pandas as pd
import pytest
from figure_checks import assert_text_fits, texts

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.names import FEATURES, family
from virtual_phantom.figures.physics_change import NAMED, draw
from virtual_phantom.statistics.physics_change import stability_change


def trusted(values):
    low, high = (np.clip(values + reach, 0, 100) for reach in (-8, 8))
    names = {"feature": FEATURES, "family": [family(name) for name in FEATURES]}
    return pd.DataFrame({**names, "stability_percent": values, "ci95_low": low, "ci95_high": high})


def change(by):
    values = np.linspace(5, 60, len(FEATURES))
    return stability_change(trusted(values + by), trusted(values))


@pytest.mark.parametrize(
    ("moved", "said"), [(0, "No feature changes significantly."), (3, "3  "), (20, f"the {NAMED} largest of 20:")]
)
def test_changes_are_counted_and_named(moved, said):
    by = np.zeros(len(FEATURES))
    by[:moved] = 30 + np.arange(moved)
    figure = draw(change(by), 1.0, noise={"dose10": 1e-5})
    assert_text_fits(figure)
    found = "\n".join(texts(figure))
    assert f"{moved} of {len(FEATURES)} features change" in found and said in found
    assert f"means: {np.linspace(5, 60, len(FEATURES)).mean():.1f} % without" in found
    if moved:
        assert f", +{30 + moved - 1}" in found
        assert "1" in texts(figure)  # next to its point


def test_highest_intervals_are_within_the_axes():
    by = np.zeros(len(FEATURES))
    by[-1] = 33.0
    figure = draw(change(by), 1.0)
    assert figure.axes[0].get_ylim()[1] > 93 + 8 - 2 and figure.axes[0].get_xlim() == figure.axes[0].get_ylim()


def test_other_tables_are_rejected():
    with pytest.raises(InputError, match="table of physics_change"):
        draw(change(np.zeros(len(FEATURES))).drop(columns="with_percent"), 1.0)
