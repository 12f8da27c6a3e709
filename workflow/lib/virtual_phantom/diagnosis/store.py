"""Fits as JSON, so that every candidate can be a job of its own."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import write_text
from .attribute import Trial
from .fit import Fit

PATTERNS = ("pattern", "pattern_variance")


def write_trial(trial: Trial, path: str | Path) -> None:
    """Write a fit, its score and its p-value."""
    fit = asdict(trial.fit)
    for name in PATTERNS:
        fit[name] = None if fit[name] is None else fit[name].tolist()
    content = {"fit": fit, "score": trial.score, "p": trial.p}
    write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", path)


def read_trial(path: str | Path) -> Trial:
    """Read what `write_trial` wrote. Raises InputError if it is missing or something else."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        fit = content["fit"]
        fit["effects"], fit["parts"] = tuple(fit["effects"]), tuple(fit["parts"])
        for name in PATTERNS:
            fit[name] = None if fit[name] is None else np.array(fit[name])
        return Trial(Fit(**fit), content["score"], content["p"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no fit of a diagnosis ({' '.join(str(error).split())}); make it anew") from None
