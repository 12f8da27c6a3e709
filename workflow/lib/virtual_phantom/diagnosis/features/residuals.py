"""Test whether features differ by more than repeats do: means and SDs by family and ROI, and the order of ROIs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from ...base.names import label
from ...statistics.comparison import compare
from ...statistics.multiplicity import bonferroni, holm
from ..residuals.residual_tests import ALPHA
from .responses import Responses

DOMAINS = ("mean", "SD", "order of regions")
SMALLEST = 1e-300  # smallest p-value, so that z is finite


@dataclass(frozen=True)
class FeatureLocation:
    """Result of the test of a feature family in one ROI, or of the order of two ROIs.

    Attributes
    ----------
    domain : {"mean", "SD", "order of regions"}
    where : str
        Family and ROIs, for texts.
    feature : str
        Feature with the largest difference.
    z : float
        Normal quantile of its uncorrected p-value. It is positive if the recorded value is larger than the simulated
        one. For an order it is positive if the recorded value is larger in the first ROI.
    p : float
        Family-wise p-value over all features, ROIs and domains.
    differing, features : int
        Number of differing and of tested features.
    """

    domain: str
    where: str
    feature: str
    z: float
    p: float
    differing: int
    features: int

    @property
    def significant(self) -> bool:
        """Whether the difference is significant."""
        return self.p < ALPHA


@dataclass(frozen=True)
class FeatureLocations:
    """Tests of all feature families and ROIs.

    Attributes
    ----------
    locations : list of FeatureLocation
        The smallest p first.
    maps : dict of str to ndarray, shape (features, ROIs or pairs of ROIs)
        z by domain.
    cells : DataFrame
        Result of comparison.compare.
    """

    locations: list[FeatureLocation]
    maps: dict[str, np.ndarray]
    cells: pd.DataFrame

    @property
    def significant(self) -> list[FeatureLocation]:
        """Locations with a significant difference."""
        return [location for location in self.locations if location.significant]


def frame(data: Responses, repeats: list[np.ndarray]) -> pd.DataFrame:
    """Return the features as a table with columns roi and tissue_class."""
    parts = [
        pd.DataFrame(values, columns=data.features).assign(roi=roi, tissue_class=data.classes[roi])
        for roi, values in zip(data.rois, repeats, strict=True)
    ]
    return pd.concat(parts, ignore_index=True)


def compare_features(data: Responses, simulated: np.ndarray) -> FeatureLocations:
    """Compare simulated features with the recording.

    Means are compared by Welch's test, SDs by the Brown-Forsythe test (statistics.comparison.compare). The order of two
    ROIs differs if simulation and recording both distinguish them, with opposite signs. Its p is the larger p of the
    two tests (intersection-union). All p are corrected over the cells of a domain (Holm) and domains (Bonferroni).

    Parameters
    ----------
    simulated : ndarray, shape (repeats, rois, features)
    """
    table = frame(data, list(simulated.transpose(1, 0, 2)))
    cells = compare(table, frame(data, data.recorded), data.features, rois=data.rois)
    pairs = list(itertools.combinations(range(len(data.rois)), 2))
    swapped = _order(simulated, data.recorded, pairs)
    shape = len(data.rois), len(data.features)
    mean, sd = (cells[name].to_numpy().reshape(shape).T for name in ("p_mean", "p_sd"))
    more = (cells["mean_recorded"] - cells["mean_simulated"]).to_numpy().reshape(shape).T
    wider = (cells["sd_recorded"] - cells["sd_simulated"]).to_numpy().reshape(shape).T
    tests = {
        "mean": (mean, np.sign(more), [f"in {label(roi)}" for roi in data.rois]),
        "SD": (sd, np.sign(wider), [f"in {label(roi)}" for roi in data.rois]),
        "order of regions": (*swapped, [f"{label(data.rois[a])} against {label(data.rois[b])}" for a, b in pairs]),
    }
    families = cells["family"].to_numpy()[: len(data.features)]
    found, maps = [], {}
    for domain, (p, sign, names) in tests.items():
        maps[domain] = sign * stats.norm.isf(np.maximum(np.nan_to_num(p, nan=1.0), SMALLEST) / 2)
        tested = np.isfinite(p)
        corrected = np.full(p.shape, np.nan)
        corrected[tested] = bonferroni(holm(p[tested]), len(tests))
        for family in dict.fromkeys(families):
            rows = np.flatnonzero(families == family)
            for column, name in enumerate(names):
                p_family = corrected[rows, column]
                if not np.isfinite(p_family).any():
                    continue
                worst = rows[np.nanargmax(np.where(np.isfinite(p_family), np.abs(maps[domain][rows, column]), np.nan))]
                z, p_worst = float(maps[domain][worst, column]), float(corrected[worst, column])
                counts = int((p_family < ALPHA).sum()), int(np.isfinite(p_family).sum())
                where = f"{family} {name}"
                found.append(FeatureLocation(domain, where, data.features[worst], z, p_worst, *counts))
    found.sort(key=lambda location: (location.p, -abs(location.z)))
    return FeatureLocations(found, maps, cells)


def _order(simulated: np.ndarray, recorded: list[np.ndarray], pairs) -> tuple[np.ndarray, np.ndarray]:
    """Return the p-values of swapped ROIs and the signs of the recorded differences, shape (features, pairs)."""
    p, sign = [], []
    for a, b in pairs:
        sides = (simulated[:, a], simulated[:, b]), (recorded[a], recorded[b])
        means = [first.mean(axis=0) - second.mean(axis=0) for first, second in sides]
        with np.errstate(divide="ignore", invalid="ignore"):
            chances = [stats.ttest_ind(*side, equal_var=False).pvalue for side in sides]
        opposite = means[0] * means[1] < 0
        p.append(np.where(opposite, np.nan_to_num(np.maximum(*chances), nan=1.0), 1.0))
        sign.append(np.sign(means[1]))
    return np.array(p).T, np.array(sign).T
