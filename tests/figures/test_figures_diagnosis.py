"""Figures of a diagnosis."""

import numpy as np
import pytest
from figure_checks import assert_text_fits
from matplotlib.backends.backend_agg import FigureCanvasAgg

from virtual_phantom.figures import diagnosis


@pytest.mark.parametrize(
    ("reach", "marks"),
    [
        (0.4, None),
        (3.9, None),
        (14.0, ["−10", "0", "10"]),
        (160.0, ["−100", "−10", "0", "10", "100"]),
        (2e5, ["−100000", "−1000", "−10", "0", "10", "1000", "100000"]),
    ],
)
def test_markers_of_residuals_are_round_and_separate(reach, marks):
    x = np.arange(1.0, 30.0)
    figure = diagnosis.draw_profiles([("detector column", x, reach * np.sin(x), 0.1 * np.cos(x))])
    assert_text_fits(figure)
    axes = figure.axes[0]
    renderer = FigureCanvasAgg(figure).get_renderer()
    labels = axes.get_yticklabels()
    low, high = axes.get_ylim()
    assert 3 <= len(labels) <= 8 and all(low <= tick <= high for tick in axes.get_yticks())
    boxes = sorted((label.get_window_extent(renderer) for label in labels), key=lambda box: box.y0)
    assert all(below.y1 <= above.y0 for below, above in zip(boxes[:-1], boxes[1:], strict=True))
    if marks:
        assert [label.get_text() for label in labels] == marks
    else:
        assert all(len(label.get_text().lstrip("−")) <= 4 for label in labels)


@pytest.mark.parametrize("image", [False, True])
def test_maps_before_and_after_are_not_saturated(image):
    """Residuals of 1300 before and of 0.5 after are within one color scale, which is linear at the small ones."""
    rng = np.random.default_rng(4)
    before, after = 1300 * rng.uniform(-1, 1, (40, 30)), 0.5 * rng.normal(size=(40, 30))
    before[0, 0] = after[0, 0] = np.nan
    axes = diagnosis.MapAxes("detector column", "view", image, (2, 1))
    data = diagnosis.draw_data(np.full((40, 30), 5.0), before, after, "bench", axes, "line integral")
    maps = diagnosis.draw_maps(before, after, None, axes, first=4)
    for figure, panels in ((data, data.axes[2:4]), (maps, maps.axes[:2])):
        assert_text_fits(figure)
        norms = [panel.get_images()[0].norm for panel in panels]
        assert norms[0] is norms[1] and norms[0].vmin == -2000 and norms[0].vmax == 2000
        shades = norms[0](np.array([-1.0, 0.0, 1.0]))
        assert shades[2] - shades[1] == pytest.approx(shades[1] - shades[0]) and shades[2] - shades[1] > 0.05
    extent = [-0.5, 29.5, 79.5, -0.5]
    assert all(panel.get_images()[0].get_extent() == extent for panel in data.axes[:4])
    letters = [panel.get_title(loc="left") for figure in (data, maps) for panel in figure.axes]
    assert "".join(letters) == "abcdef"
    diagnosis.draw_maps(np.zeros((3, 3)), np.zeros((3, 3)), None, axes)


def test_image_profile_shows_both_models_and_their_differences():
    x = np.linspace(-50, 50, 21)
    profile = {"x_mm": x, "recorded": 40 + 0.01 * x**2, "before": np.full(21, 40.0), "after": 40 + 0.009 * x**2}
    figure = diagnosis.draw_image_profile(profile, 9)
    assert_text_fits(figure)
    left, right = ([line.get_ydata() for line in axes.get_lines()] for axes in figure.axes)
    np.testing.assert_allclose(left, [profile["recorded"], profile["before"], profile["after"]])
    np.testing.assert_allclose(right[1:], [0.01 * x**2, 0.001 * x**2], atol=1e-12)
    assert [axes.get_ylabel() for axes in figure.axes] == ["mean CT number (HU)", "recorded − modeled (HU)"]


def test_ranking_marks_the_gain_beside_the_other_effects():
    figure = diagnosis.draw_ranking({"scatter": 900.0, "heel": 40.0}, {"scatter": 700.0}, {"scatter"})
    (axes,) = figure.axes
    (mark,) = [line for line in axes.get_lines() if line.get_marker() == "D"]
    assert mark.get_xdata().tolist() == [700.0] and mark.get_ydata().tolist() == [0]
    assert sorted(bar.get_width() for bar in axes.patches) == [40, 900]
