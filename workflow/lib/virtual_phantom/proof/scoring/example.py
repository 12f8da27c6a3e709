"""The case that the page shows as an example, and its residual maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from ...base.names import label
from ...diagnosis.result_files import RESIDUAL_MAPS
from ...diagnosis.verdict_text import EXPLAINED
from ...io.files import check_unchanged
from ..hiding.case import Case

MEAN = "projections"  # the domain of the mean, ray by ray
SHOWN_FIRST = ("strong", "medium", "weak", None)


def example(cases: Sequence[Case]) -> Case:
    """Return a typical case with an exactly right verdict.

    Candidates are cases with one hidden effect of the largest available strength. The verdict names precisely this
    effect and leaves nothing unexplained. The effect changes the mean, because maps show the mean. Conditions that no
    case meets are ignored. The result has the median of the excess removed (the lower of two).

    Raises
    ------
    InputError
        If there are no cases.
    """
    if not cases:
        raise InputError("proof: there are no cases to score; set proof.effects or proof.none")
    candidates = [case for case in cases if case.category == "single"] or list(cases)
    candidates = [case for case in candidates if case.exact and case.diagnosis["verdict"] == EXPLAINED] or candidates
    candidates = [case for case in candidates if MEAN in case.truth["where"]] or candidates
    strength = next(strength for strength in SHOWN_FIRST if any(case.strength == strength for case in candidates))
    candidates = [case for case in candidates if case.strength == strength]
    ranked = sorted(candidates, key=lambda case: (case.diagnosis["excess_rms_removed"] or 0.0, case.name))
    return ranked[(len(ranked) - 1) // 2]


def in_words(case: Case) -> tuple[str, str]:
    """Return the hidden and the named effects in words."""
    strength = f" ({case.strength})" if case.strength and case.hidden else ""
    hidden = " and ".join(map(label, case.hidden)) or "nothing"
    return hidden + strength, " and ".join(map(label, case.named)) or "nothing"


def residual_maps(folder: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the standardized residuals before and after the fit from a folder of maps.

    Returns
    -------
    before, after : ndarray, shape (down, across)

    Raises
    ------
    InputError
        If a map is missing or invalid.
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
            raise InputError(f"{path}: is not a map of finite numbers; diagnose it again")
        found.append(values)
    return found[0], found[1]
