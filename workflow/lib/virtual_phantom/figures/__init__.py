"""Figures of the study: functions `draw` or `draw_...` return a Figure, and style.save writes the files."""

from ..base.plotting import import_matplotlib

import_matplotlib()
