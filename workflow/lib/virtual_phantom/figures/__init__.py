"""Figures of the study: each module has a function draw(...) -> Figure, and style.save writes the files."""

from ..base.plotting import import_matplotlib

import_matplotlib()
