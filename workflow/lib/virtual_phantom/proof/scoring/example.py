"""The case that is shown, and its maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from ...base.names import label
from ...diagnosis.selection.store import RESIDUAL_MAPS
from ...io.files import check_unchanged
from ..hiding.case import Case

MEAN = "projections"  # the domain of the mean, ray by ray
SHOWN_FIRST = ("strong", "medium", "weak", None)


def example(cases: Sequence[Case]) -> Case:
    """A typical case.

    Of those with one effect (else of all) that changes the mean, which maps show, of the largest strength there is, the
    one whose excess removed is the median (the lower of two). Never the best one, and whether it is right plays no
    part.

    Raises
    ------
    InputError
        If there are no cases.
    """
    if not cases:
        raise InputError("proof: there are no cases; nothing can be scored")
    taken = [case for case in cases if case.category == "single"] or list(cases)
    taken = [case for case in taken if MEAN in case.truth["where"]] or taken
    strength = next(one for one in SHOWN_FIRST if any(case.strength == one for case in taken))
    taken = [case for case in taken if case.strength == strength]
    ranked = sorted(taken, key=lambda case: (case.diagnosis["excess_removed"] or 0.0, case.name))
    return ranked[(len(ranked) - 1) // 2]


def in_words(case: Case) -> tuple[str, str]:
    """What is concealed, and what was named."""
    strength = f" ({case.strength})" if case.strength and case.concealed else ""
    concealed = " and ".join(map(label, case.concealed)) or "nothing"
    return concealed + strength, " and ".join(map(label, case.named)) or "nothing"


def residual_maps(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Standardised residuals before and after, from the maps of a diagnosis.

    Parameters
    ----------
    folder : str or Path
        Of the maps.

    Returns
    -------
    before, after : ndarray, shape (down, across)

    Raises
    ------
    InputError
        If one is missing or no such map.
    """
    found = []
    for name in RESIDUAL_MAPS:
        path = Path(folder) / f"{name}.npy"
        check_unchanged(path, "diagnose it again")
        try:
            values = np.load(path, allow_pickle=False)
        except Exception as error:  # numpy raises many types on broken files
            raise InputError(f"{path}: cannot be read ({' '.join(str(error).split())}); diagnose it again") from None
        if values.ndim != 2 or not np.isfinite(values).all():
            raise InputError(f"{path}: is no map of finite numbers; diagnose the recording again")
        found.append(values)
    return found[0], found[1]
