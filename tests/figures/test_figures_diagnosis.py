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
