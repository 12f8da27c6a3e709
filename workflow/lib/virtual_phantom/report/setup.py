"""The report of a recording whose description is wrong, or that is of another object."""

from __future__ import annotations

from datetime import date

import numpy as np

from .. import __version__
from ..figures import diagnosis as figures
from .html import picture, render_diagnosis


def setup_page(content: dict, stated: np.ndarray, best: np.ndarray) -> str:
    """The report as HTML.

    Parameters
    ----------
    content : dict
        Of diagnosis.json (diagnosis.setup.verdict).
    stated, best : ndarray, shape (views, columns)
        What the scan as it is described, and as it should be, leaves of the line integrals.
    """
    maps = picture(figures.draw_setup(stated, best, content["recording"], content["setup"]["of"]))
    return render_diagnosis(
        "diagnosis_of_setup", content, maps=maps, version=__version__, date=date.today().isoformat()
    )
