"""Where tables of features differ beyond repeats: means and SDs by family and region, and the order of the regions."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from ...base.words import label
from ...statistics.comparison import compare
from ...statistics.multiplicity import bonferroni, holm
from ..residuals.residual_tests import ALPHA
from .responses import Responses

DOMAINS = ("mean", "SD", "order of regions")
SMALLEST = 1e-300  # of a p-value, so that its z is finite


@dataclass(frozen=True)
class Place:
    """A family of features in a region, or between two.

    Attributes
    ----------
    domain : str
        Of DOMAINS.
    where : str
        The place, in words.
    feature : str
        The one that differs most.
    z : float
        Its normal quantile, positive where the recording holds more (of order: where it has the first higher).
    p : float
        Chance of one as small anywhere without a difference: family-wise over all features, places and domains.
    differing, features : int
        Features that differ there, and that were tested there.
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
        """Whether it is a difference."""
        return self.p < ALPHA


@dataclass(frozen=True)
class Places:
    """Where features were compared, and how they differ.

    Attributes
    ----------
    places : list of Place
        All of them, the worst first.
    maps : dict of str to ndarray, shape (features, places)
        z by domain, of regions or pairs of regions.
    cells : DataFrame
        The comparison behind them.
    """

    places: list[Place]
    maps: dict[str, np.ndarray]
    cells: pd.DataFrame

    @property
    def significant(self) -> list[Place]:
        """Those that differ."""
        return [place for place in self.places if place.significant]


def frame(data: Responses, repeats: list[np.ndarray]) -> pd.DataFrame:
    """Features of every ROI as a table with columns roi and tissue_class.

    Parameters
    ----------
    repeats : list of ndarray, shape (repeats, features)
        Of every ROI.
    """
    parts = [
        pd.DataFrame(values, columns=data.features).assign(roi=roi, tissue_class=data.classes[roi])
        for roi, values in zip(data.rois, repeats, strict=True)
    ]
    return pd.concat(parts, ignore_index=True)


def places(data: Responses, simulated: np.ndarray) -> Places:
    """Compare features with the recording's.

    Means by Welch's test and SDs by Brown and Forsythe's, as statistics.comparison.compare has them. The order of two
    regions differs in a feature where both sides tell them apart, the other way round; its p is the larger of the two
    (an intersection-union test). Holm's correction runs over all cells of a domain, Bonferroni's over domains.

    Parameters
    ----------
    simulated : ndarray, shape (repeats, rois, features)
    """
    ours = frame(data, list(simulated.transpose(1, 0, 2)))
    cells = compare(ours, frame(data, data.recorded), data.features, rois=data.rois)
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
                own = corrected[rows, column]
                if not np.isfinite(own).any():
                    continue
                worst = rows[np.nanargmax(np.where(np.isfinite(own), np.abs(maps[domain][rows, column]), np.nan))]
                found.append(
                    Place(
                        domain,
                        f"{family} {name}",
                        data.features[worst],
                        float(maps[domain][worst, column]),
                        float(corrected[worst, column]),
                        int((own < ALPHA).sum()),
                        int(np.isfinite(own).sum()),
                    )
                )
    found.sort(key=lambda one: (one.p, -abs(one.z)))
    return Places(found, maps, cells)


def _order(simulated: np.ndarray, recorded: list[np.ndarray], pairs) -> tuple[np.ndarray, np.ndarray]:
    """Chance that a pair's order is swapped.

    Parameters
    ----------
    simulated : ndarray, shape (repeats, rois, features)
    recorded : list of ndarray, shape (repeats, features)
        Of every ROI.
    pairs : list of tuple of 2 int
        Of ROIs.

    Returns
    -------
    p : ndarray, shape (features, pairs)
    sign : ndarray, shape (features, pairs)
        Of the recorded difference.
    """
    p, sign = [], []
    for a, b in pairs:
        sides = (simulated[:, a], simulated[:, b]), (recorded[a], recorded[b])
        means = [one.mean(axis=0) - other.mean(axis=0) for one, other in sides]
        with np.errstate(divide="ignore", invalid="ignore"):
            chances = [stats.ttest_ind(*side, equal_var=False).pvalue for side in sides]
        opposite = means[0] * means[1] < 0
        p.append(np.where(opposite, np.nan_to_num(np.maximum(*chances), nan=1.0), 1.0))
        sign.append(np.sign(means[1]))
    return np.array(p).T, np.array(sign).T
