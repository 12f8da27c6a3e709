"""Scores of the default study at further values of `seed`, which give its variation over random realizations."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..base.data import RESOURCES
from ..io.files import read_csv
from .ranking import KINDS


def read_seed_scores() -> pd.DataFrame:
    """Read one row per seed and feature.

    Columns: settings (`plan.Plan.scored_settings`), seed, feature, stability_percent, discrimination_percent.
    """
    return read_csv(RESOURCES / "default_study_seeds.csv")


def match_settings(seeds: pd.DataFrame, settings: str) -> bool:
    """Return whether all scores come from a study with these settings."""
    return set(seeds["settings"]) == {settings}


def sd_over_seeds(seeds: pd.DataFrame) -> tuple[float, ...]:
    """SD over seeds of the mean over features, for stability and for discrimination."""
    return tuple(float(np.std(seed_means(seeds, kind), ddof=1)) for kind in KINDS)


def seed_means(seeds: pd.DataFrame, kind: str) -> np.ndarray:
    """Mean over features for every seed."""
    return seeds.groupby("seed")[f"{kind}_percent"].mean().to_numpy()
