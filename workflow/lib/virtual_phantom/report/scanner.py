"""The report of a scanner: what its recordings share, and how each is met by the physics of the others."""

from __future__ import annotations

from datetime import date

from .. import __version__
from ..figures import scanner as figures
from .html import COLOURS, OTHER_COLOUR, number, picture, render, within


def page(content: dict) -> str:
    """The report as HTML.

    Parameters
    ----------
    content : dict
        Of scanner.json.

    Returns
    -------
    str
    """
    removed = picture(figures.draw_recordings(content["recordings"]))
    colour = COLOURS.get(content["verdict"], OTHER_COLOUR)
    filters = {"number": number, "within": within}
    every = (
        (effect, key) for one in content["recordings"].values() for effect, keys in one["own"].items() for key in keys
    )
    shown = {"own": list(dict.fromkeys(every))}
    shown |= {"removed": removed, "colour": colour, "version": __version__, "date": date.today().isoformat()}
    return render("scanner", filters, d=content | {"recording": content["scanner"]}, **shown)
