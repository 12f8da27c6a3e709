"""Figures of templates: every one is there, on its own scale, and legible."""

import numpy as np
from figure_checks import assert_text_fits, texts
from generators.effect_templates import Panel, draw_correlations, draw_templates

NAMES = [f"source distance: isocentre {number}" for number in range(23)]


def test_templates_have_scales_of_their_own():
    wave = np.sin(np.arange(200.0)).reshape(20, 10)
    panels = [Panel("weak", 0.02 * wave, "column"), Panel("strong", 300 * wave, "row: noise variance")]
    panels.append(Panel("few", np.array([1.0, -44.0]), "noise correlation, neighbouring", ("columns", "rows")))
    figure = draw_templates(panels)
    assert_text_fits(figure)
    found = texts(figure)
    assert {"weak", "strong", "few", "±0.02", "±300", "44", "columns", "row: noise variance"} <= set(found)
    limits = [axes.images[0].get_clim() for axes in figure.axes if axes.images]
    np.testing.assert_allclose(limits, [(-0.02, 0.02), (-300, 300)], rtol=1e-3)


def test_correlations_are_written_where_they_are_not_next_to_nothing():
    correlation = np.eye(23)
    correlation[0, 1] = correlation[1, 0] = -0.978
    correlation[0, 2] = correlation[2, 0] = 0.049
    correlation[5] = correlation[:, 5] = np.nan
    figure = draw_correlations(correlation, NAMES)
    assert_text_fits(figure)
    found = texts(figure)
    assert found.count("−98") == 2 and found.count("100") == 22 and "5" not in found
    assert set(NAMES) <= set(found)
