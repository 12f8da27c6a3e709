"""Figures of templates: all are shown, on their own scales, and legible."""

import numpy as np
from figure_checks import assert_text_fits, texts
from generators.effect_templates import Panel, draw_correlations, draw_templates

NAMES = [f"source drift: columns acceleration {number}" for number in range(23)]


def test_templates_have_their_own_scales():
    wave = np.sin(np.arange(200.0)).reshape(20, 10)
    panels = [Panel("weak", 0.02 * wave, "column"), Panel("strong", 300 * wave, "row: noise variance")]
    panels.append(Panel("few", np.array([1.0, -44.0]), "noise correlation, neighbouring", ("columns", "rows")))
    figure = draw_templates(panels)
    assert_text_fits(figure)
    found = texts(figure)
    assert {"weak", "strong", "few", "±0.02", "±300", "44", "columns", "row: noise variance"} <= set(found)
    limits = [axes.images[0].get_clim() for axes in figure.axes if axes.images]
    np.testing.assert_allclose(limits, [(-0.02, 0.02), (-300, 300)], rtol=1e-3)


def test_correlations_have_the_colors_of_their_values():
    correlation = np.eye(23)
    correlation[0, 1] = correlation[1, 0] = -0.978
    correlation[5] = correlation[:, 5] = np.nan
    figure = draw_correlations(correlation, NAMES)
    assert_text_fits(figure)
    assert set(NAMES) <= set(texts(figure))
    (shown,) = figure.axes[0].collections
    np.testing.assert_array_equal(shown.get_array().filled(np.nan), correlation)
    assert shown.get_clim() == (-1, 1)
