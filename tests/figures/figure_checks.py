"""Checks for every figure."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from virtual_phantom.figures import style

SMALLEST_POINTS = 7


def texts(figure):
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def assert_text_fits(figure):
    """Fail if text is cut off at the figure's edges or smaller than SMALLEST_POINTS."""
    with style.styled():
        canvas = FigureCanvasAgg(figure)
        figure.draw_without_rendering()  # positions of the layout
        tight = figure.get_tightbbox(canvas.get_renderer())
    assert tight.x0 >= -0.02 and tight.y0 >= -0.02, tight
    assert tight.x1 <= figure.get_figwidth() + 0.02 and tight.y1 <= figure.get_figheight() + 0.02, tight
    assert min(text.get_fontsize() for text in figure.findobj(Text)) >= SMALLEST_POINTS
