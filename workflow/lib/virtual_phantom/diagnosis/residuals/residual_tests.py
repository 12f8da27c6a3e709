"""Statistical tests of a fit's residuals: where recording and model differ beyond noise."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special, stats

from ...statistics.multiplicity import bonferroni, holm
from ..fitting.fit import Fit
from ..fitting.nuisance import PLACE, display_name
from ..noise.condensed import FEWEST, Blocks, Observed

EDGES = "edges"  # domain of the data with the steepest slopes
ALPHA = 0.01  # family-wise level, over all domains and their locations
EDGE_SHARE = 0.1  # share of the rays or voxels, with the steepest slopes, that count as edges
BINS = 10  # of rays or voxels sorted by a value


@dataclass(frozen=True)
class DomainTest:
    """Test of a domain (a set of locations), with its worst location.

    Attributes
    ----------
    where : str
        The location, in words.
    z : float
        Standardized difference at the location, positive where the recording is larger. In domains that are tested for
        an excess only (report.words.ONE_SIDED), z does not show which is larger.
    p : float
        p-value over all locations of the domain; `holm_corrected` extends it to all domains.
    map : ndarray
        z of every location, for figures; along three axes for blocks.
    """

    domain: str
    where: str
    z: float
    p: float
    map: np.ndarray

    @property
    def significant(self) -> bool:
        """Whether p is below ALPHA; valid over all domains after `holm_corrected` (Holm)."""
        return self.p < ALPHA


@dataclass(frozen=True)
class HalfResiduals:
    """Residuals and weights of the fitted or the held-out data.

    Attributes
    ----------
    residuals, weights : list of ndarray, shape (data,)
        By part: mean of the repeats, and for several repeats the noise variance and the noise correlations.
    """

    residuals: list[np.ndarray]
    weights: list[np.ndarray]
    data: Observed

    def in_common(self, other: HalfResiduals) -> HalfProducts:
        """Return the products of the residuals of both halves, for the mean of the repeats."""
        weight = np.sqrt(self.weights[0] * other.weights[0])
        return HalfProducts(
            weight > 0,
            self.residuals[0] * other.residuals[0] * weight,
            [weight * error.ravel() ** 2 for error in self.data.numerical],
            np.ravel(self.data.weight_variance),
        )


@dataclass(frozen=True)
class HalfProducts:
    """Products of standardized residuals of two halves with independent noise, by ray or voxel.

    Attributes
    ----------
    there : ndarray of bool, shape (data,)
        Data that count in both halves.
    products : ndarray, shape (data,)
        Their mean estimates d^2, where d is the difference common to both halves, in standard deviations.
    numerical : list of ndarray, shape (data,)
        Expected products by each numerical error of the model.
    weight_variance : ndarray, shape (data,), or float
        Relative variance of the weights, which adds to the variance of the products.
    """

    there: np.ndarray
    products: np.ndarray
    numerical: list[np.ndarray]
    weight_variance: np.ndarray | float = 0.0

    def z(self, where: np.ndarray | None = None) -> float:
        """Return (sum of products - sum expected from numerical errors) / SD, at least 0.

        The SD is the value without a common difference d. z tests d^2, so it does not show the sign of d.
        A numerical error c D with c ~ N(0, 1) gives c^2 times its expected sum; c^2 has a variance of 2.

        Parameters
        ----------
        where : ndarray of bool, shape (data,), optional
            Data that are summed; None: all that count.
        """
        chosen = self.there if where is None else self.there & where
        numerical = np.array([float(error[chosen].sum()) for error in self.numerical])
        beyond = float(self.products[chosen].sum()) - numerical.sum()
        noise = float(np.sum(1 + np.broadcast_to(self.weight_variance, chosen.shape)[chosen]))
        return max(0.0, beyond) / float(np.sqrt(max(1.0, noise) + 2 * (numerical**2).sum()))


def alignment_tests(fit: Fit, numerical: Collection[str]) -> list[DomainTest]:
    """Test nuisance parameters against their priors.

    A wrong value in the description of the scan shifts a parameter and leaves no residual.

    The pose of the object and the numerical errors are omitted, as their size is uncertain. The list is empty without
    priors.
    """
    z = {name: value for name, value in fit.pulls.items() if name not in numerical and name not in PLACE}
    if not z:
        return []
    names, values = list(z), np.array(list(z.values()))
    words = "{}, {:.1f} standard deviations from its prior"
    return [extreme("alignment", values, lambda i: words.format(display_name(names[i]), abs(values[i])))]


def standardized(sums, total, extra=0.0) -> np.ndarray:
    """Return sums of weighted residuals over their SD, for total weights and extra variances; 0 without weight."""
    return sums / np.sqrt(np.where(total > 0, total + extra, np.inf))


def noise_tests(
    half: HalfResiduals,
    pairs: list[str],
    axes: tuple[str, str, str],
    fitted: HalfResiduals | None = None,
    uncertain: Sequence[np.ndarray] | None = None,
    step: int = 1,
) -> list[DomainTest]:
    """Test the noise: its variance by block, its level, and its correlations.

    Noise level and correlations of held-out data are compared with the fitted data. Both have errors of
    similar size, so the tests include both. The list is empty if there is a single repeat.

    Parameters
    ----------
    pairs : list of str
        Names of the correlated neighbors.
    fitted : HalfResiduals, optional
        The fitted data, if `half` is held-out data.
    uncertain : sequence of ndarray, shape (directions, data), optional
        By part, changes of the data by one standard error of the fitted parameters. None: the noise of the fitted data
        is used instead.
    """
    residuals, weights, data = half.residuals, half.weights, half.data
    if data.variance is None:
        return []
    if fitted is not None and fitted.data.variance is None:
        fitted = None  # a single repeat
    level, total = residuals[1] @ weights[1], weights[1].sum()
    single = weights[1] / data.alone
    of_blocks = variance_z(residuals[1], single)
    with np.errstate(divide="ignore"):
        error = 1 / weights[2]
        if uncertain is not None:
            both = 1 / total + ((uncertain[1] @ weights[1] / total) ** 2).sum()
            error = error + (uncertain[2] ** 2).sum(axis=0)
            of_blocks = of_blocks / np.sqrt(1 + single * (uncertain[1] ** 2).sum(axis=0))
        else:
            both = 1 / total + (1 / fitted.weights[1].sum() if fitted else 0)
            error = error + (1 / fitted.weights[2] if fitted else 0)
    z = float(level / total / np.sqrt(both))
    return [
        blocks("noise variance", of_blocks, data, axes, step=step, division=data.noise_blocks),
        DomainTest("noise level", "everywhere", z, _two_sided(z, 1), np.array([z])),
        extreme("noise correlation", residuals[2] / np.sqrt(error), lambda i: f"between {pairs[i]}"),
    ]


def variance_z(residual: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return normal scores of sample variances, shape (blocks,).

    The cube root of a chi-square is nearly normal [1]_; its logarithm has a long lower tail for few degrees of freedom.

    Parameters
    ----------
    residual, weight : ndarray, shape (blocks,)
        Residuals of the unbiased logarithms, and their inverse variances; 0 where there is no variance.

    References
    ----------
    .. [1] E. B. Wilson and M. M. Hilferty, PNAS 17, 684, 1931.
    """
    freedom = 2 * np.where(weight > 0, weight, 1.0)  # the variance of the logarithm is 2 over the degrees of freedom
    ratio = np.exp(residual + special.digamma(freedom / 2) - np.log(freedom / 2))
    spread = 2 / (9 * freedom)
    return np.where(weight > 0, (np.cbrt(ratio) - 1 + spread) / np.sqrt(spread), 0.0)


def holm_corrected(found: list[DomainTest]) -> list[DomainTest]:
    """Return locations with p corrected over domains (Holm), the worst first."""
    found = sorted(found, key=lambda location: location.p)
    together = holm(np.array([location.p for location in found]))
    return [replace(location, p=float(p)) for location, p in zip(found, together, strict=True)]


@dataclass(frozen=True)
class ExtraVariance:
    """Variance of sums of weighted rays in addition to independent noise.

    Attributes
    ----------
    weight : ndarray, shape (views, rows, columns)
    distortions : sequence of ndarray, shape (views, rows, columns)
        Errors common to all rays of a sum, one standard deviation.
    weight_variance : ndarray, shape (views, rows, columns), or float
        Relative variance of the estimated, unbiased weights w: <w^2> / <w>^2 - 1.
    """

    weight: np.ndarray
    distortions: Sequence[np.ndarray]
    weight_variance: np.ndarray | float = 0.0

    def __call__(self, total) -> np.ndarray | float:
        """Return the extra variance of sums over many blocks; `total` sums weighted rays."""
        return total(self.weight * self.weight_variance) + self.of_block(total)

    def of_block(self, total) -> np.ndarray | float:
        """Return the extra variance for rays of one block.

        All rays of a block share one estimated weight. Its error does not add variance, but the sum follows Student's t
        distribution (`normal_scores`).
        """
        return sum((total(self.weight * distortion) ** 2 for distortion in self.distortions), 0.0)


def _two_sided(z: float, places: int) -> float:
    """Return a two-sided p-value with Bonferroni's correction."""
    return float(bonferroni(2 * stats.norm.sf(abs(z)), places))


def _p_value(z: np.ndarray) -> float:
    """Return the p-value of the worst location or of the sum of squares, whichever is smaller, times two."""
    tested = z[z != 0]
    if not tested.size:
        return 1.0
    worst = _two_sided(float(np.abs(tested).max()), tested.size)
    return min(1.0, 2 * min(worst, float(stats.chi2.sf((tested**2).sum(), tested.size))))


def extreme(domain: str, z: np.ndarray, words) -> DomainTest:
    """Test a domain for its worst location; `words` describes the location of an index."""
    worst = int(np.argmax(np.abs(z)))
    return DomainTest(domain, words(worst), float(z[worst]), _p_value(z), z)


def normal_scores(z: np.ndarray, weight_variance: np.ndarray | float) -> np.ndarray:
    """Return normal scores of values.

    Values with measured variances have Student's t distribution, which Wallace's bound [1]_ converts.

    Parameters
    ----------
    z : ndarray
        Scaled to a variance of 1, as unbiased weights give it. (Student's t has a variance of n / (n - 2).)
    weight_variance : ndarray or float
        Relative variance of the weights, 2 over the degrees of freedom n; 0: the variances are known.

    References
    ----------
    .. [1] D. L. Wallace, Ann. Math. Stat. 30, 1124, 1959: his 8n + 1 over 8n + 3.
    """
    weight_variance = np.broadcast_to(weight_variance, z.shape)
    measured = (weight_variance > 0) & (weight_variance < 2 / FEWEST)
    n = 2 / np.where(measured, weight_variance, 1)
    square = z**2 * n / np.where(measured, n - 2, 1)
    scores = np.sign(z) * np.sqrt(n * np.log1p(square / n)) * (8 * n + 1) / (8 * n + 3)
    return np.where(measured, scores, z)


def blocks(
    domain: str,
    z: np.ndarray,
    data: Observed,
    axes: tuple[str, str, str],
    weight_variance: np.ndarray | float = 0.0,
    step: int = 1,
    division: Blocks | None = None,
) -> DomainTest:
    """Test blocks of the data.

    Parameters
    ----------
    z : ndarray, shape (blocks,)
    weight_variance : ndarray, shape (blocks,), or float, optional
        Relative variance of the weights behind z.
    step : int, optional
        Step between the used positions of the first axis. Texts have the numbers of the recording.
    division : Blocks, optional
        None: the data's blocks.
    """
    division = division or data.blocks
    worst = int(np.argmax(np.abs(z)))
    ranges = []
    for axis, block in enumerate(np.unravel_index(worst, division.shape)):
        first, end = division.bounds(axis)[block : block + 2]
        every = step if axis == 0 else 1
        ranges.append(f"{axes[axis]} {every * first} to {every * (end - 1)}")
    p = _p_value(normal_scores(z, weight_variance))
    return DomainTest(domain, ", ".join(ranges), float(z[worst]), p, z.reshape(division.shape))


def by_value(
    domain: str, words: str, residual, weight, values, inside, extra_variance: ExtraVariance | None = None
) -> DomainTest:
    """Sort the data `inside` by a value, divide them into BINS bins and test each.

    `words` is a text with two fields for the bounds of a bin.
    """
    edges = np.quantile(values[inside], np.linspace(0, 1, BINS + 1)) if inside.any() else np.zeros(BINS + 1)
    index = np.where(inside, np.clip(np.searchsorted(edges, values) - 1, 0, BINS - 1), BINS)

    def by_bin(values):
        return np.bincount(index.ravel(), values.ravel(), BINS + 1)[:BINS]

    extra = 0.0 if extra_variance is None else extra_variance(by_bin)
    z = standardized(by_bin(residual * weight), by_bin(weight), extra)
    return extreme(domain, z, lambda i: words.format(edges[i], edges[i + 1]))


def steep(weight, slope) -> np.ndarray:
    """Return a mask of the data with the steepest slopes, among those with weight."""
    return (weight > 0) & (slope >= np.quantile(slope[weight > 0], 1 - EDGE_SHARE))


def steepest(
    what: str, residual, weight, slope, numbers: Sequence[np.ndarray] = (), of_weights: float = 0.0
) -> DomainTest:
    """Test the excess of chi-square where a slope is steepest, one-sided.

    Parameters
    ----------
    what : str
        Rays or voxels, for messages.
    numbers : sequence of ndarray, optional
        Changes of the data by one standard error of the fitted parameters.
    of_weights : float, optional
        Variance of chi-square by errors of the weights.
    """
    chosen = steep(weight, slope)
    count = int(chosen.sum())
    square = float((weight[chosen] * residual[chosen] ** 2).sum())
    expected = count + sum(float((weight[chosen] * change[chosen] ** 2).sum()) for change in numbers)
    square *= count / max(1.0, expected)
    z = (square - count) / np.sqrt(2 * count + of_weights)
    freedom = 2 * count**2 / (2 * count + of_weights)  # of the chi-square with this mean and variance, but for a factor
    p = float(stats.chi2.sf(square * freedom / count, freedom))
    return DomainTest(EDGES, f"the {100 * EDGE_SHARE:.0f} % steepest {what}", float(z), p, np.array([z]))
