"""Render the page of the blind validation: one HTML file with its figures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..base.errors import InputError
from ..figures import confusion
from ..figures.before_after import MAP_LIMIT, thumbnail
from ..statistics.proof_record import QUANTITIES
from .agreement_table import NAMES
from .html import COLORS, OTHER_COLOR, data_url, number, picture, render


def blind_validation_page(
    score: Mapping, maps: Mapping[str, tuple[np.ndarray, np.ndarray]], reports: Mapping[str, str]
) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    score : mapping
        Result of proof.scoring.score.
    maps : mapping of str to tuple of 2 ndarray, shape (down, across)
        {case: standardized residuals before and after}.
    reports : mapping of str to str
        {case: path of its report, relative to the page}.

    Raises
    ------
    InputError
        For a case without maps.
    """
    for name in [*(case["case"] for case in score["cases"]), *(real["recording"] for real in score["recordings"])]:
        if name not in maps:
            raise InputError(f"{name}: has no maps; diagnose it again")
    filters = {"number": number, "percent": percent, "tally": tally, "reached": reached, "valued": valued}
    filters["colour"] = lambda verdict: COLORS.get(verdict, OTHER_COLOR)
    pictures = {case: tuple(data_url(thumbnail(values)) for values in pair) for case, pair in maps.items()}
    return render(
        "proof",
        filters,
        s=score,
        names=NAMES,
        quantities=QUANTITIES,
        targets={target["name"]: target for target in score["targets"]},
        matrix=picture(confusion.draw(score["confusion"])),
        pictures=pictures,
        reports=reports,
        limit=MAP_LIMIT,
    )


def percent(value: float | None) -> str:
    """Return a share in percent, with one decimal near 0 and 100; a dash for None."""
    if value is None:
        return "–"
    if 0.9995 <= value < 1:
        return "over 99.9 %"
    return f"{100 * value:.1f} %" if 0 < value < 0.0995 or 0.9905 < value < 1 else f"{100 * value:.0f} %"


def tally(share: Mapping) -> str:
    """Return a share with its count and interval."""
    if not share["n"]:
        return "no cases"
    low, high = (percent(bound) for bound in share["ci95"])
    text = f"{share['count']:.4g} of {share['n']} ({percent(share['share'])}; {low.removesuffix(' %')} to {high})"
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def reached(target: Mapping) -> tuple[str, str]:
    """Return the CSS class and the word (reached or not) for a target."""
    return {True: ("reached", "reached"), False: ("missed", "missed"), None: ("open", "not measured")}[
        target["reached"]
    ]


def valued(value: float | None, target: Mapping) -> str:
    """Return the value of a target with its unit."""
    if value is None:
        return "–"
    return percent(value) if target["unit"] == "share" else f"{number(value)} {target['unit']}"
