"""The study's figures: one module each with a pure draw(...) -> Figure; style.save writes them."""

from ..base.plotting import import_matplotlib

import_matplotlib()
