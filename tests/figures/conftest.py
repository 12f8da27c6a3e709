"""Made-up inputs of the figures, in the form of the study's outputs."""

import numpy as np
import pandas
import pytest

from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.volumes import Volume
from virtual_phantom.statistics.noise import EVERY_ROI

CLASSES = {
    "normal_1": "normal_liver",
    "normal_2": "normal_liver",
    "cyst_1": "cyst",
    "cyst_2": "cyst",
    "hemangioma": "hemangioma",
    "metastasis": "metastasis",
}
FAMILIES = {"firstorder": 18, "glcm": 22, "gldm": 14, "glrlm": 16, "glszm": 16}


@pytest.fixture
def rng():
    return np.random.default_rng(20220415)


@pytest.fixture
def make_phantom():
    """Make an elliptic body with balls of 8 mm for a list of ROI names; returns (HU, {name: mask})."""

    def make(names, shape=(24, 64, 80), spacing=(5.0, 4.0, 4.0)):
        grid = Grid(shape, spacing, centre_mm=(3.0, -7.0, 100.0))
        z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij", sparse=True)
        image = np.where((x / 140) ** 2 + (y / 105) ** 2 + 0 * z < 1, 50.0, -1000.0).astype(np.float32)
        masks = {}
        for index, name in enumerate(names):
            angle = 2 * np.pi * index / len(names)
            centre = 70 * np.cos(angle), 50 * np.sin(angle), 20 * (index % 2) - 10
            masks[name] = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < 11.0**2
            image[masks[name]] = 90 - 20 * (index % 5)
        return Volume(image, grid), masks

    return make


@pytest.fixture
def calibration():
    """Two protocols with five levels; variances on a line plus scatter; rows per ROI and for all ROIs."""
    rng = np.random.default_rng(7)
    rows = []
    for protocol, slope, intercept in (("sirt_450", 1.5e6, 40.0), ("fbp_450", 2.6e6, 60.0)):
        for level in (0.5e-4, 1e-4, 2e-4, 3e-4, 4e-4):
            for roi in (EVERY_ROI, *CLASSES):
                variance = (intercept + slope * level) * (1 + (0.02 if roi == EVERY_ROI else 0.2) * rng.normal())
                rows.append(
                    {
                        "protocol": protocol,
                        "noise": f"a{level:.1e}",
                        "noise_level": level,
                        "repeats": 10,
                        "roi": roi,
                        "variance_hu2": variance,
                        "standard_error": 0.03 * variance,
                        "spatial_variance_hu2": variance + 50,
                    }
                )
    return pandas.DataFrame(rows)


@pytest.fixture
def stability(rng):
    """86 features: few stable, most discriminating, many with equal values."""
    rows = [
        (f"original_{family}_Feature{index}", family) for family, count in FAMILIES.items() for index in range(count)
    ]
    table = pandas.DataFrame(rows, columns=["feature", "family"])
    table["stability_percent"] = np.round(rng.beta(0.9, 4, len(table)) * 112) / 112 * 100
    table["discrimination_percent"] = np.round(rng.beta(9, 1, len(table)) * 48) / 48 * 100
    return table


@pytest.fixture(scope="session")
def overlap():
    """All list lengths of 86. Discriminative power has the band of independent features, stability a wider one."""
    from scipy.stats import hypergeom

    n = np.arange(1, 87)
    shared = hypergeom(86, n, n)
    mean = n**2 / 86
    above = np.minimum(n, mean + 0.35 * (n - mean))
    lower, upper = shared.ppf(0.025), shared.ppf(0.975)
    return pandas.DataFrame(
        {
            "n_top": n,
            "percent": 100 * n / 86,
            "overlap_stability_percent": 100 * np.round(above) / n,
            "overlap_stability_sd": 100 * np.sqrt(n * (86 - n)) / 86 / n,
            "expected_stability_percent": 100 * mean / n,
            "lower_stability_percent": 100 * np.maximum(2 * lower - mean, 0) / n,
            "upper_stability_percent": 100 * np.minimum(2 * upper - mean, n) / n,
            "overlap_discrimination_percent": 100 * np.ceil((above + mean) / 2) / n,
            "overlap_discrimination_sd": np.nan,
            "expected_discrimination_percent": 100 * mean / n,
            "lower_discrimination_percent": 100 * lower / n,
            "upper_discrimination_percent": 100 * upper / n,
        }
    )


@pytest.fixture
def draws(stability):
    """Two random realizations of measured scores of 85 features, with 4 of 12 repeats:

    those of `stability`, and 2 % more.
    """
    scores = stability.drop(columns="family").iloc[:85].assign(repeats=4, of=12)
    more = {name: scores[name] + 2 for name in ("stability_percent", "discrimination_percent")}
    return pandas.concat([scores.assign(draw=1), scores.assign(draw=2, **more)], ignore_index=True)


@pytest.fixture
def make_pca():
    """Make measured rows and 7 projections x 4 levels x 5 seeds per ROI, for a list of ROI names."""

    def make(names=tuple(CLASSES), measured=8):
        rng = np.random.default_rng(11)
        rows = []
        for index, roi in enumerate(names):
            centre = 6 * np.array([np.cos(index), np.sin(index)])
            common = {
                "roi": roi,
                "tissue_class": CLASSES.get(roi, roi),
                "explained_pc1_percent": 61.234,
                "explained_pc2_percent": 17.5,
            }
            for projections in range(150, 451, 50):
                for level in (0.8e-4, 1e-4, 1.2e-4, 1.4e-4):
                    for seed in range(5):
                        shift = [(projections - 300) / 100, (level - 1e-4) * 1e4 * 1.5]
                        pc1, pc2 = centre + shift + 0.3 * rng.normal(size=2)
                        rows.append(
                            {
                                "source": "simulated",
                                "protocol": f"sirt_{projections}",
                                "algorithm": "SIRT",
                                "projections": projections,
                                "noise": "a",
                                "noise_level": level,
                                "seed": seed,
                                "pc1": pc1,
                                "pc2": pc2,
                                **common,
                            }
                        )
            for group in range(measured):
                pc1, pc2 = centre + rng.normal(size=2)
                rows.append(
                    {
                        "source": "measured",
                        "protocol": f"group_{group + 1}",
                        "algorithm": None,
                        "projections": np.nan,
                        "noise": None,
                        "noise_level": np.nan,
                        "seed": np.nan,
                        "pc1": pc1,
                        "pc2": pc2,
                        **common,
                    }
                )
        return pandas.DataFrame(rows)

    return make


@pytest.fixture
def controls():
    """Mean scores with their controls."""
    return pandas.DataFrame(
        {
            "score": ["stability", "stability", "discrimination", "discrimination", "discrimination"],
            "control": ["protocols", "chance", "different classes", "same class", "chance"],
            "percent": [10.0, 68.5, 92.0, 89.0, 31.5],
        }
    )
