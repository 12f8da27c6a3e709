"""Scores of the default study at further values of `seed`: how far its numbers move with the draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ..base.data import RESOURCES
from ..io.files import read_csv
from .ranking import KINDS


def load(path: str | Path = RESOURCES / "default_study_seeds.csv") -> pd.DataFrame:
    """Read the scores of all seeds.

    Returns
    -------
    DataFrame
        One row per seed and feature: settings (`plan.Plan.scored_settings`), seed, feature, stability_percent,
        discrimination_percent.
    """
    return read_csv(path)


def made_with(seeds: pd.DataFrame, settings: str) -> bool:
    """Whether they are of a study with these settings."""
    return set(seeds["settings"]) == {settings}


def spread(seeds: pd.DataFrame) -> tuple[float, ...]:
    """SD over seeds of the mean over features, of both kinds of score."""
    return tuple(float(np.std(means(seeds, kind), ddof=1)) for kind in KINDS)


def means(seeds: pd.DataFrame, kind: str) -> np.ndarray:
    """Mean over features for each seed."""
    return seeds.groupby("seed")[f"{kind}_percent"].mean().to_numpy()
