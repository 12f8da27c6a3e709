"""The course of a diagnosis, from a recording made ready to its verdict: of a user's recordings and in the proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ..physics.effect import offered
from .residuals.change import Change
from .residuals.dataset import Prepared
from .selection.fit_cache import FitCache
from .selection.forward_selection import Choice, choose
from .selection.progress import ALIGNED, JUDGED, DiagnosisProgress
from .selection.screening import screened
from .selection.transfer import Physics, stated, verified
from .selection.trials import trials
from .uncertainty.model_error import errors_with_models
from .verdict.object_mismatch import (
    MOST_PIECES,
    beside,
    better_than,
    beyond_effects,
    differing,
    explains_all,
    no_physics,
)
from .verdict.unmodelled import ChangesOfFits
from .verdict.verdict import Diagnosis, diagnose


def explain(
    name: str,
    prepared: Prepared,
    effects: Sequence[str],
    accuracy: Mapping[str, float],
    processes: int = 1,
    kept: FitCache | None = None,
    how_far: DiagnosisProgress | None = None,
    object_may_differ: bool | float = False,
) -> tuple[Prepared, Diagnosis]:
    """Choose the effects that explain a recording, and judge them.

    Parameters
    ----------
    name : str
        Of the recording.
    effects : sequence of str
        Candidates.
    accuracy : mapping of str to float
        As choose takes it.
    processes : int, optional
        As choose takes them.
    kept : FitCache, optional
        As choose takes them.
    how_far : DiagnosisProgress, optional
        What is told while it goes on.
    object_may_differ : bool or float, optional
        Whether pieces of the object that explain more than any effect are mended before effects are chosen; a number:
        those that are at most so wide, mm.

    Returns
    -------
    prepared : Prepared
        With the noise by which the recording was judged.
    """
    how_far, numerical, changes = how_far or DiagnosisProgress(), accuracy.get("numerical", 0.0), ChangesOfFits()
    widest_mm = math.inf if object_may_differ is True else float(object_may_differ)
    pieces: list[Change] = []

    def may_be_mended(piece: Change) -> bool:
        return piece.piece.content["width_mm"] <= widest_mm

    def choice(one: Prepared, kept: FitCache | None) -> Choice:
        (baseline,) = trials(one.fitter, [((),)], kept=kept)
        how_far.reached(ALIGNED)
        piece = differing(changes(one, baseline.fit, numerical)) if len(pieces) < MOST_PIECES else None
        if piece is not None and pieces and not may_be_mended(piece):
            piece = None  # effects are chosen beside those that were mended
        alone = None
        if piece is not None:
            first = offered(effects, one.fitter.model.whole(()))
            alone = screened(one.fitter, baseline.fit, first, processes, how_far, accuracy) if first else {}
            if beyond_effects(piece, alone) or explains_all(piece, one, baseline):
                return no_physics(baseline, piece, numerical)
        found = choose(one.fitter, baseline, effects, processes, accuracy, kept, how_far, alone)
        better = piece is not None and not pieces and better_than(piece, found)
        return no_physics(baseline, piece, numerical) if better else found

    while True:
        # Fits that are kept know of no pieces.
        prepared, chosen = _settled(prepared, choice, None if pieces else kept)
        piece = None
        if widest_mm and len(pieces) < MOST_PIECES:
            piece = chosen.piece or beside(prepared, chosen, changes)
        if piece is None or not may_be_mended(piece):
            break
        prepared, pieces = prepared.with_piece(piece.piece, chosen.chosen.fit), [*pieces, piece]
    told = prepared.pieces(chosen.chosen.fit) if pieces else ()
    pieces = [replace(piece, words=one.words, piece=one) for piece, one in zip(pieces, told, strict=True)]
    chosen = replace(chosen, errors=errors_with_models(prepared.fitter, chosen.chosen.fit, chosen.without, accuracy))
    found = diagnose(name, prepared, chosen, pieces, changes)
    how_far.reached(JUDGED)
    return prepared, found


def hold_against(
    name: str, prepared: Prepared, physics: Physics, same_material: bool, kept: FitCache | None = None
) -> tuple[Prepared, Diagnosis]:
    """Judge a recording by physics that was found on another: only the alignment is fitted.

    Parameters
    ----------
    name : str
        Of the recording.
    same_material : bool
        As verified takes it.
    kept : FitCache, optional
        As explain takes them.

    Returns
    -------
    diagnosis : Diagnosis
        As explain returns them.
    """

    def choice(one: Prepared, kept: FitCache | None) -> Choice:
        (baseline,) = trials(one.fitter, [((),)], kept=kept)
        return verified(one.fitter, baseline, physics, same_material)

    prepared, chosen = _settled(prepared, choice, kept)
    found = diagnose(name, prepared, chosen)
    return prepared, replace(found, content=stated(found.content, physics))


def _settled(
    prepared: Prepared, choice: Callable[[Prepared, FitCache | None], Choice], kept: FitCache | None
) -> tuple[Prepared, Choice]:
    """A choice; a second one where the first says how the noise is correlated and the recording does not.

    For that all models are fitted again by the new likelihood, so that they compare.

    Parameters
    ----------
    choice : callable
        (Prepared, KeptFits or None) to Choice.
    kept : FitCache or None
        For the first one.
    """
    chosen = choice(prepared, kept)
    again = prepared.with_noise_of(chosen.chosen.fit)
    return (prepared, chosen) if again is prepared else (again, choice(again, None))
