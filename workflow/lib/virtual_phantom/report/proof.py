"""The page of the blind test: one HTML file with its pictures inside."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jinja2 import Environment, StrictUndefined

from ..base.errors import InputError
from ..figures import confusion, style
from ..figures.before_after import thumbnail
from ..figures.diagnosis import MAP_LIMIT
from .agreement_table import NAMES
from .html import COLOURS, FOOT, OTHER_COLOUR, STYLE, data_url, number, picture
from .proof_parts import ACCURACY, AGREEMENT, CALIBRATION, GALLERY, HEADLINE, MISSED, MODELS, PARAMETERS, REAL, RECORD

HEAD = (
    """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Proof on concealed effects</title>
<style>
"""
    + STYLE
    + """body { max-width: 68rem; }
th.n { text-align: right; } .reached, .missed, .open { white-space: nowrap; }
.reached { color: #007355; } .missed { color: #B34700; font-weight: 600; } .open { color: #555; }
.cases { display: grid; grid-template-columns: repeat(auto-fill, minmax(20rem, 1fr)); gap: 1rem; }
.case { border: 1px solid #ddd; border-top: 5px solid #999; padding: .5rem .8rem; font-size: .88rem; }
.case h3 { margin: 0 0 .3rem; font-size: 1rem; } .case p { margin: .25rem 0; overflow-wrap: anywhere; }
.maps { display: grid; grid-template-columns: 1fr 1fr; gap: .4rem; margin: .4rem 0; }
.maps img { width: 100%; height: 7rem; image-rendering: pixelated; border: 1px solid #ddd; box-sizing: border-box; }
.maps figure { margin: 0; } .maps figcaption { font-size: .8rem; color: #555; }
.two { display: flex; flex-wrap: wrap; gap: 0 3rem; }
</style></head><body>
<h1>Proof on concealed effects</h1>
<p>{{ s.counts.cases }} recordings were made by another simulator, XCIST/CatSim: projector, cross-sections, detection
and noise are its own. What each conceals was sealed, and the seal's SHA-256 published, before it was made; every
verdict was fixed by its own before the seal was opened. All cases count.</p>
"""
)
PAGE = (
    HEAD + RECORD + HEADLINE + MODELS + ACCURACY + AGREEMENT + PARAMETERS + CALIBRATION + MISSED + REAL + GALLERY + FOOT
)


def page(score: Mapping, maps: Mapping[str, tuple[np.ndarray, np.ndarray]], reports: Mapping[str, str]) -> str:
    """The page as HTML.

    score     what score.score found
    maps      {case: standardised residuals [down, across] before and after}
    reports   {case: its report, relative to the page}
    Raises InputError for a case without maps.
    """
    for name in [*(case["case"] for case in score["cases"]), *(one["recording"] for one in score["recordings"])]:
        if name not in maps:
            raise InputError(f"{name}: has no maps; diagnose it again")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters |= {
        "label": style.label,
        "number": number,
        "percent": percent,
        "tally": tally,
        "reached": reached,
        "valued": valued,
        "colour": lambda verdict: COLOURS.get(verdict, OTHER_COLOUR),
    }
    pictures = {case: tuple(data_url(thumbnail(values)) for values in pair) for case, pair in maps.items()}
    return environment.from_string(PAGE).render(
        s=score,
        names=NAMES,
        matrix=picture(confusion.draw(score["confusion"])),
        pictures=pictures,
        reports=reports,
        limit=MAP_LIMIT,
    )


def percent(value: float | None) -> str:
    """A share in percent, to a tenth near its ends; a dash for None."""
    if value is None:
        return "–"
    if 0.9995 <= value < 1:
        return "over 99.9 %"
    return f"{100 * value:.1f} %" if 0 < value < 0.0995 or 0.9905 < value < 1 else f"{100 * value:.0f} %"


def tally(share: Mapping) -> str:
    """A share with its count and interval."""
    if not share["n"]:
        return "no cases"
    low, high = (percent(bound) for bound in share["ci95"])
    text = f"{share['count']} of {share['n']} ({percent(share['share'])}; {low.removesuffix(' %')} to {high})"
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def reached(target: Mapping) -> tuple[str, str]:
    """Class and word."""
    return {True: ("reached", "reached"), False: ("missed", "missed"), None: ("open", "not measured")}[
        target["reached"]
    ]


def valued(value: float | None, target: Mapping) -> str:
    """A target's value in its unit."""
    if value is None:
        return "–"
    return percent(value) if target["unit"] == "share" else f"{number(value)} {target['unit']}"
