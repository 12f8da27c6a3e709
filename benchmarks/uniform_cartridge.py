"""Predict texture features of uniform acrylic on seven GE scanners from two numbers per scanner (10 minutes).

The table holds 91 pyradiomics features of the Credence cartridge phantom [1]_, [2]_, [3]_. Its acrylic cartridge is
uniform, so that its features are those of noise. For each scanner, the noise SD and the in-plane resolution of the
noise are fitted to the mean variance and the mean GLCM correlation of eight of the 16 sub-regions. The features of the
other eight are predicted and compared with the measured ones, beside simpler predictions. Predictions use the mean HU
and the boxes of the fitted sub-regions. The constants of the noise were chosen on DEVELOPMENT; TEST was predicted once,
afterward.

References
----------
.. [1] D. Mackin et al., Invest. Radiol. 50, 757, 2015.
.. [2] CC-Radiomics-Phantom, The Cancer Imaging Archive, CC BY 3.0.
.. [3] Table: github.com/AbdallaIbrahim/The-reproducibility-and-ComBatability-of-Radiomic-features, features_ge.csv.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import SimpleITK as sitk
from radiomics.featureextractor import RadiomicsFeatureExtractor

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.streams import Stream, below, generator, named, root
from virtual_phantom.features.names import MEAN, VARIANCE
from virtual_phantom.image_model.noise import NoiseModel
from virtual_phantom.io.files import read_csv

SEED = 519
DEVELOPMENT, TEST = (1, 3, 6), (2, 4, 5, 7)  # column Batch
CORRELATION = "original_glcm_Correlation"
ROUNDING = 1 / 12  # HU^2, variance that rounding to HU adds
SHIFT = 1024  # of values for Energy, TotalEnergy and RootMeanSquared; bins are those of HU
FAMILIES = ("firstorder", "glcm", "gldm", "glrlm", "glszm", "ngtdm")
SETTINGS = {"binWidth": 25, "voxelArrayShift": SHIFT}
THICKNESSES = (2.5, 1.25, 3.75, 5.0)  # mm, of GE scanners, most frequent of [1]_ first
SIDE_MM = 20.0  # of a sub-region
# The four constants that all scanners share, and a common MTF as a control, from DEVELOPMENT. Ten variants were tried:
# ratio 1.4 to 2.2, constant 0.1 to 1 per cm, slice SD 0.4 to 0.7, amplitude 0 to 0.2. With amplitude 0.1, they
# predicted 97.4 to 98.9 % of the features, with 0 97.1 %, and with 0.2 93.0 %, as the kurtosis was wrong.
MTF_RATIO = 1.7  # frequency of 10 % over that of 50 %
LOW_FREQUENCY_PER_CM = 0.3
SLICE_SD = 0.5  # over the slice thickness
LOG_AMPLITUDE_SD = 0.1
COMMON_MTF50_PER_CM = 4.2
MTF50_PER_CM = np.geomspace(1.5, 9.0, 14)  # searched
FIT_REALIZATIONS, REALIZATIONS = 3, 6  # of each sub-region


@dataclass(frozen=True)
class Box:
    """Sub-region: voxels along z, y and x, and voxel size in mm."""

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]


def box(voxels: int, voxel_mm3: float) -> Box:
    """Return the box of about 20 mm with this many voxels; InputError if there is none.

    The slice thickness is the first of THICKNESSES for which the field of view of 512 pixels is a whole number of cm.
    """
    for thickness in THICKNESSES:
        found = []
        pixel = (voxel_mm3 / thickness) ** 0.5
        field = pixel * 512
        if not 90 < field < 505 or abs(field / 10 - round(field / 10)) > 0.005:
            continue
        for slices in range(1, 41):
            for rows in range(1, 81):
                columns, rest = divmod(voxels, slices * rows)
                if rest or columns < rows:
                    continue
                sides = np.array([slices * thickness, rows * pixel, columns * pixel])
                steps = np.array([thickness, pixel, pixel])
                if (np.abs(sides - SIDE_MM) < 1.6 * steps).all():
                    misfit = float((((sides - SIDE_MM) / steps) ** 2).sum())
                    found.append((misfit, Box((slices, rows, columns), (thickness, pixel, pixel))))
        if found:
            return min(found, key=lambda one: one[0])[1]
    raise InputError(f"no box of 20 mm has {voxels} voxels of {voxel_mm3:.4f} mm^3")


def read(path: Path, scanners: Sequence[int] = (*DEVELOPMENT, *TEST)) -> pd.DataFrame:
    """Acrylic rows of these scanners by (scanner, sub-region): the features and the column `box`."""
    table = read_csv(path)
    table = table[table["ROI"].str.startswith("acrylic_") & table["Batch"].isin(scanners)]
    table = table.assign(region=table["ROI"].str.removeprefix("acrylic_").astype(int))
    table = table.set_index(["Batch", "region"]).sort_index()
    energy = table["original_firstorder_Energy"]
    voxels = (energy / table["original_firstorder_RootMeanSquared"] ** 2).round().astype(int)
    volumes = table["original_firstorder_TotalEnergy"] / energy
    features = table.filter(like="original_")
    return features.assign(box=[box(n, v) for n, v in zip(voxels, volumes, strict=True)])


def fitted_regions(table: pd.DataFrame) -> np.ndarray:
    """Mask of the fitted sub-regions: the fields of one color of a checkerboard of 4 x 4."""
    region = table.index.to_numpy()
    return (region // 4 + region % 4) % 2 == 0


@cache
def extractor(names: tuple[str, ...] | None = None) -> RadiomicsFeatureExtractor:
    """All features of the original image, or the named GLCM features."""
    logging.getLogger("radiomics").setLevel(logging.ERROR)
    made = RadiomicsFeatureExtractor(**SETTINGS)
    made.disableAllFeatures()
    if names:
        made.enableFeaturesByName(glcm=list(names))
    else:
        for family in FAMILIES:
            made.enableFeatureClassByName(family)
    return made


def features(image: np.ndarray, spacing: tuple[float, ...], names: tuple[str, ...] | None = None) -> pd.Series:
    """Features of a whole image [z, y, x] after rounding to HU."""
    values = sitk.GetImageFromArray(np.pad(np.rint(image).astype(np.int16), 1))
    label = sitk.GetImageFromArray(np.pad(np.ones(image.shape, np.uint8), 1))
    for one in (values, label):
        one.SetSpacing(spacing[::-1])
    found = extractor(names).execute(values, label)
    return pd.Series({key: float(value) for key, value in found.items() if key.startswith("original_")})


def correlated(mtf50_per_cm: float, thickness_mm: float) -> NoiseModel:
    """Noise with the constants that all scanners share."""
    slice_sd = SLICE_SD * thickness_mm
    return NoiseModel(mtf50_per_cm, mtf50_per_cm * MTF_RATIO, LOW_FREQUENCY_PER_CM, slice_sd, LOG_AMPLITUDE_SD)


def images(
    model: NoiseModel | None, boxes: Sequence[Box], means: Sequence[float], variance: float, stream: Stream
) -> list[np.ndarray]:
    """One image per box with its mean, HU; `variance` is the mean over boxes. Noise is white if `model` is None."""
    fields = []
    for k, one in enumerate(boxes):
        own = below(stream, k)
        field = model.sample(one.shape, one.spacing, own) if model else generator(own).standard_normal(one.shape)
        fields.append(field - field.mean())
    sd = ((variance - ROUNDING) / np.mean([field.var() for field in fields])) ** 0.5
    return [mean + sd * field for mean, field in zip(means, fields, strict=True)]


def predict(
    model: NoiseModel | None,
    known: pd.DataFrame,
    variance: float,
    stream: Stream,
    realizations: int = REALIZATIONS,
    names: tuple[str, ...] | None = None,
) -> pd.Series:
    """Mean features over realizations of sub-regions with the boxes and mean HU of `known`."""
    rows = [
        features(image, one.spacing, names)
        for k in range(realizations)
        for image, one in zip(
            images(model, known["box"], known[MEAN], variance, below(stream, k)), known["box"], strict=True
        )
    ]
    return pd.DataFrame(rows).mean()


def fit_mtf50(known: pd.DataFrame, stream: Stream) -> float:
    """MTF50 at which the GLCM correlation is that of `known`; the same random numbers are used at each MTF50."""
    thickness = known["box"].iloc[0].spacing[0]
    found = [
        predict(correlated(mtf50, thickness), known, known[VARIANCE].mean(), stream, FIT_REALIZATIONS, ("Correlation",))
        for mtf50 in MTF50_PER_CM
    ]
    falling = np.minimum.accumulate([one[CORRELATION] for one in found])
    return float(np.exp(np.interp(-known[CORRELATION].mean(), -falling, np.log(MTF50_PER_CM))))


def within(predicted: pd.Series, measured: pd.DataFrame) -> pd.Series:
    """Whether each predicted feature is within one SD over sub-regions of the measured mean."""
    return (predicted - measured.mean()).abs() <= measured.std() + 1e-12 * measured.mean().abs()


def r_squared(predicted: pd.DataFrame, measured: pd.DataFrame) -> pd.Series:
    """Coefficient of determination of each feature (column) over scanners (rows)."""
    return 1 - ((predicted - measured) ** 2).sum() / ((measured - measured.mean()) ** 2).sum()


MODEL, COMMON, WHITE = "two numbers", "common MTF", "white noise"
OWN, UPPER = "two numbers, own mean HU", "fitted sub-regions"
LINE = "line in noise SD"


def sd_line(table: pd.DataFrame, names: list[str], variance: float) -> pd.Series:
    """Features at a noise variance from lines in the noise SD through the fitted sub-regions of DEVELOPMENT."""
    rows = [table.loc[scanner] for scanner in DEVELOPMENT]
    means = pd.DataFrame([one[fitted_regions(one)][names].mean() for one in rows])
    lines = np.polyfit(np.sqrt(means[VARIANCE]), means, 1)
    return pd.Series(lines[0] * np.sqrt(variance) + lines[1], names)


def predictions(known: pd.DataFrame, held_out: pd.DataFrame, stream: Stream) -> tuple[float, dict[str, pd.Series]]:
    """MTF50, and the mean features of the held-out sub-regions by predictor; only OWN uses `held_out`."""
    thickness, variance = known["box"].iloc[0].spacing[0], known[VARIANCE].mean()
    mtf50 = fit_mtf50(known, below(stream, 0))
    model = correlated(mtf50, thickness)
    return mtf50, {
        MODEL: predict(model, known, variance, below(stream, 1)),
        OWN: predict(model, held_out, variance, below(stream, 1)),
        COMMON: predict(correlated(COMMON_MTF50_PER_CM, thickness), known, variance, below(stream, 1)),
        WHITE: predict(None, known, variance, below(stream, 2)),
        UPPER: known.drop(columns="box").mean(),
    }


def add_arguments(parser):
    parser.add_argument("--table", type=Path, required=True, help="features_ge.csv")
    parser.add_argument("--scanners", type=int, nargs="+", default=[*DEVELOPMENT, *TEST])


def run(options):
    table = read(options.table, options.scanners)
    names = [name for name in table if name != "box"]
    hits, predicted, measured = {}, {}, {}
    for scanner in options.scanners:
        rows = table.loc[scanner]
        chosen = fitted_regions(rows)
        known, held_out = rows[chosen], rows[~chosen]
        mtf50, found = predictions(known, held_out, named(root(SEED), scanner))
        if scanner in TEST and set(DEVELOPMENT) <= set(options.scanners):
            found[LINE] = sd_line(table, names, known[VARIANCE].mean())
        real = held_out[names].astype(float)
        for title, values in found.items():
            predicted[title, scanner] = values[names]
            hits[title, scanner] = within(values[names], real)
        measured[scanner] = real.mean()
        one = rows["box"].iloc[0]
        print(f"\nGE {scanner}: box {one.shape}, {one.spacing[0]:g} mm slices, pixels of {one.spacing[1]:.4f} mm")
        print(f"mean HU {known[MEAN].mean():.1f}, SD over sub-regions {known[MEAN].std():.2f}", end="; ")
        print(f"noise SD {(known[VARIANCE].mean() - ROUNDING) ** 0.5:.2f} HU, MTF50 {mtf50:.2f} per cm", end="")
        print(" (bound of the search)" if np.isclose(mtf50, MTF50_PER_CM[[0, -1]]).any() else "")
        for title in found:
            print(f"  within one SD, {title}: {100 * hits[title, scanner].mean():.1f} % of {len(names)}")
        missed_white = ~hits[WHITE, scanner]
        print(f"  of {missed_white.sum()} that white noise misses, two numbers hit", end=" ")
        print((missed_white & hits[MODEL, scanner]).sum(), end=", a common MTF hits ")
        print((missed_white & hits[COMMON, scanner]).sum())
        z = (found[MODEL][names] - real.mean()) / real.std()
        for name in z[~hits[MODEL, scanner]].sort_values(key=abs, ascending=False).index:
            print(f"  missed by two numbers: {name.removeprefix('original_')} {z[name]:+.2f} SD", flush=True)
    titles = list(dict.fromkeys(title for title, _ in hits))
    for label, scanners in (("development", DEVELOPMENT), ("test", TEST), ("all", (*DEVELOPMENT, *TEST))):
        if not set(scanners) <= set(options.scanners):
            continue
        print(f"\n{label} scanners {scanners}")
        truth = pd.DataFrame({scanner: measured[scanner] for scanner in scanners}).T
        explained = {}
        squares = truth.corrwith(truth[VARIANCE] ** 0.5) ** 2
        print(f"squared correlation with the noise SD above 0.9 for {(squares > 0.9).sum()}")
        for title in titles:
            if any((title, scanner) not in hits for scanner in scanners):
                continue
            shares = [100 * hits[title, scanner].mean() for scanner in scanners]
            values = pd.DataFrame({scanner: predicted[title, scanner] for scanner in scanners}).T
            explained[title] = r_squared(values, truth)
            squares = values.corrwith(truth) ** 2
            print(f"{title}: within one SD {np.mean(shares):.1f} % ({min(shares):.1f} to {max(shares):.1f})", end="; ")
            print(f"R^2 above 0.9 for {(explained[title] > 0.9).sum()}, above 0.5 for", end=" ")
            print(f"{(explained[title] > 0.5).sum()}; squared correlation above 0.9 for {(squares > 0.9).sum()}")
        if label != "development":
            low = explained[MODEL].sort_values().head(12)
            print("lowest R^2, two numbers:", {k.removeprefix("original_"): round(v, 2) for k, v in low.items()})
            for family in FAMILIES:
                inside = [name for name in names if f"_{family}_" in name]
                medians = {title: round(float(values[inside].median()), 2) for title, values in explained.items()}
                print(f"median R^2 of {len(inside)} {family} features:", medians)
