"""The report of a scanner: what its recordings share, and how each is met by the physics of the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    """
    removed = picture(figures.draw_recordings(content["recordings"]))
    colour = COLOURS.get(content["verdict"], OTHER_COLOUR)
    filters = {"number": number, "within": within}
    shown = {kind: _parameters(content["recordings"].values(), kind) for kind in ("alone", "own")}
    shown |= {"removed": removed, "colour": colour, "version": __version__, "date": date.today().isoformat()}
    return render("scanner", filters, d=content | {"recording": content["scanner"]}, **shown)


def _parameters(recordings: Iterable[Mapping], kind: str) -> list[tuple[str, str]]:
    """Every (effect, parameter) that recordings have of this kind."""
    return list(
        dict.fromkeys((effect, key) for one in recordings for effect, keys in one[kind].items() for key in keys)
    )
