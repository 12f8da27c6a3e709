"""The report of a diagnosis: one HTML file with its pictures inside."""

from __future__ import annotations

from datetime import date

import numpy as np

from .. import __version__
from ..diagnosis.fitting.fit import Fit
from ..diagnosis.residuals.dataset import Prepared
from ..diagnosis.verdict.doubts import advice
from ..diagnosis.verdict.verdict import Diagnosis
from ..diagnosis.wording import UNITS
from ..figures import diagnosis as figures
from ..io.volumes import Volume
from ..physics.effect import load
from .agreement_table import agreement_table
from .html import picture, render_diagnosis
from .words import DOMAINS, NUISANCES, ONE_SIDED

STEPPED = "views"  # the domain of which one place of so many is taken
PIXELS_ACROSS = 120  # of the map: more blocks than that hold too few rays to show anything


def page(
    diagnosis: Diagnosis,
    prepared: Prepared,
    alpha: float,
    maps: tuple[np.ndarray, np.ndarray],
    scanned: Volume | None = None,
) -> str:
    """The report as HTML.

    Parameters
    ----------
    alpha : float
        Below which a place's p is significant.
    maps : tuple of 2 ndarray
        From `residual_maps`.
    scanned : Volume, optional
        Image of what was scanned, HU.
    """
    content = diagnosis.content
    after = {place.domain: place for place in diagnosis.after}
    choice, look = diagnosis.choice, prepared.look
    return render_diagnosis(
        "diagnosis",
        content,
        effects={one["name"]: load(one["name"]) for one in content["effects"]},
        doubts=[
            *(f"{doubt}." for doubt in content["doubts"]),
            *advice(choice.chosen.fit, prepared.fitter.model),
            *content["caveats"],
        ],
        places=[(place, after[place.domain]) for place in diagnosis.before],
        alpha=alpha,
        agreement=agreement_table(content.get("agreement")),
        maps=picture(
            figures.draw_maps(
                *maps,
                _title(content, prepared),
                look.across,
                look.down,
                image=look.summed == 0,
                steps=_steps(prepared),
            )
        ),
        profiles=picture(figures.draw_profiles(_profiles(diagnosis, prepared))),
        one_repeat=look.one_repeat,
        ranking=picture(figures.draw_ranking(choice.alone, choice.chosen.fit.effects, choice.singles))
        if choice.alone
        else None,
        pieces=_pieces(content, scanned),
        object=None if scanned is None else picture(figures.draw_object(scanned)),
        domains=DOMAINS,
        quantities=UNITS,
        one_sided=ONE_SIDED,
        nuisances=NUISANCES,
        version=__version__,
        date=date.today().isoformat(),
    )


def _pieces(content: dict, scanned: Volume | None) -> str | None:
    """The pieces of the object that differ, drawn in what was stated of it."""
    found = content.get("object", {}).get("pieces", [])
    return picture(figures.draw_pieces(scanned, found)) if found and scanned is not None else None


def residual_maps(diagnosis: Diagnosis, prepared: Prepared) -> tuple[np.ndarray, np.ndarray]:
    """What the report shows: standardised residuals of the data held out, before and after.

    Returns
    -------
    before, after : ndarray, shape (down, across)
    """
    return tuple(_map(one.fit, prepared) for one in (diagnosis.choice.baseline, diagnosis.choice.chosen))


def _map(fit: Fit, prepared: Prepared) -> np.ndarray:
    """Standardised residual of the data held out: weighted means over one axis and over blocks of rays or voxels."""
    fitter = prepared.fitter
    shape = prepared.held_out.mean.shape
    residual, weight = (part[0].reshape(shape) for part in (fitter.residuals(fit), fitter.held_weights))
    summed = prepared.look.summed
    sums, weights = (residual * weight).sum(axis=summed), weight.sum(axis=summed)
    for axis in (0, 1):
        step = _block(sums.shape[axis])
        edges = np.arange(0, sums.shape[axis], step)
        sums, weights = (np.add.reduceat(part, edges, axis) for part in (sums, weights))
    return sums / np.sqrt(np.where(weights > 0, weights, np.inf))


def _block(places: int) -> int:
    """How many places of an axis are one of the map's."""
    return -(-places // PIXELS_ACROSS)


def _steps(prepared: Prepared) -> tuple[int, int]:
    """How many of the recording's places one of the map's stands for, down and across."""
    down, across = (n for axis, n in enumerate(prepared.held_out.mean.shape) if axis != prepared.look.summed)
    return prepared.step * _block(down), _block(across)


def _profiles(diagnosis: Diagnosis, prepared: Prepared) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    panels = []
    for domain, label, first in prepared.look.profiles:
        step = prepared.step if domain == STEPPED else 1
        before, after = (
            next(one for one in side if one.domain == domain).map for side in (diagnosis.before, diagnosis.after)
        )
        panels.append((label, step * np.arange(before.size) + first, before, after))
    return panels


def _title(content: dict, prepared: Prepared) -> str:
    return f"{content['recording']}: mean over {('slices', 'rows')[prepared.look.summed]}"
