"""Predict features of the printed phantom at other doses, and compare predictions with measured ones (10 minutes).

Fits the image model (virtual_phantom.image_model) to the features of the dose series at 10 mGy. Noise comes from the
large cyst at 10 mGy; at 1 and 3 mGy, only the variance of the large cyst is used. Prints the share of features within
one repeat SD of the measured means, by dose, reconstruction and region, and the order of the regions, beside simpler
predictions. --parameters FILE keeps the fitted parameters (JSON), so that they are not fitted again.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import Stream, named, root
from virtual_phantom.features.names import FEATURES, MEAN, VARIANCE
from virtual_phantom.image_model.dose import DoseLaw
from virtual_phantom.image_model.fitting import Measured, fit_noise, fit_region
from virtual_phantom.image_model.noise import NoiseModel
from virtual_phantom.image_model.region import Blur, RegionModel
from virtual_phantom.image_model.scanner import ImageScanner, stream_pairs
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.phantom.texture import Component
from virtual_phantom.statistics import measured, roi_profiles

SEED = 51
SPACING = (1.0, 0.684, 0.684)  # mm, of the dose series
FITTED, DOSES = 10, (1, 3, 10)  # mGy
UNIFORM = "cyst_1"
RECONSTRUCTIONS = ("fbp", "iterative")
BLUR = Blur(2.98, 5.06, 0.85)  # kernel of config/as_scanned.yaml; a slice of 2 mm
REALIZATIONS = {"hemangioma": 1, "metastasis": 4}  # while fitting, others SMALL
SMALL = 8
START = {
    "cyst_2": RegionModel(1.2, Component(2, 3, 0.3), Component(2, 8)),
    "hemangioma": RegionModel(1.1, Component(15, 2.0, 1.6), Component(6, 8)),
    "metastasis": RegionModel(1.1, Component(9, 2.0, 0.6), Component(6, 8)),
    "normal_1": RegionModel(1.1, Component(13, 1.6, 1.4), Component(5, 8)),
    "normal_2": RegionModel(1.1, Component(7, 1.6, 1.4), Component(4, 8)),
}


def masks() -> dict[str, np.ndarray]:
    """Regions of the drawn phantom on the scanner's voxels, each cropped to its bounding box."""
    grid = Grid((170, 310, 430), SPACING)
    found = {}
    for roi in synthetic.rois(layout.read_layout(), grid, root(SEED)):
        found[roi.name] = roi.mask[tuple(slice(i.min(), i.max() + 1) for i in np.nonzero(roi.mask))]
    return found


def series() -> dict[tuple[str, str, int], Measured]:
    """Measured features by (region, reconstruction, dose)."""
    table = measured.load_dose_series()
    return {
        key: Measured(rows["mean"].reindex(FEATURES), rows["sd"].reindex(FEATURES))
        for key, rows in table.set_index("feature").groupby(["roi", "reconstruction", "dose_mgy"])
    }


def fit(real: dict, regions: dict[str, np.ndarray], stream: Stream) -> tuple[dict, dict, Component]:
    """Noise by reconstruction, model by region, and the pattern of the uniform region, fitted at one dose."""
    noise, pattern = {}, None
    for name in RECONSTRUCTIONS:
        known = real[UNIFORM, name, FITTED]
        noise[name], pattern = fit_noise(known, regions[UNIFORM], SPACING, named(stream, UNIFORM), pattern=pattern)
        print(name, noise[name], pattern, flush=True)
    scanner = make_scanner(noise, pattern, real)
    models = {UNIFORM: RegionModel(1.0, Component(0.0, 1.0), pattern)}
    for roi, start in START.items():
        known = {name: real[roi, name, FITTED] for name in RECONSTRUCTIONS}
        realizations = REALIZATIONS.get(roi, SMALL)
        models[roi] = fit_region(
            scanner, known, FITTED, regions[roi], start, named(stream, roi), realizations=realizations
        )
        print(roi, models[roi], flush=True)
    return noise, models, pattern


def make_scanner(noise: dict[str, NoiseModel], pattern: Component, real: dict) -> ImageScanner:
    """The scanner, with the variance of the large cyst less that of its pattern at every dose."""
    laws = {
        name: DoseLaw({dose: real[UNIFORM, name, dose].mean[VARIANCE] - pattern.sd_hu**2 for dose in DOSES})
        for name in RECONSTRUCTIONS
    }
    return ImageScanner(SPACING, BLUR, noise, laws)


def predict(scanner, models, regions, real, stream, realizations: int = 12) -> dict[tuple[str, str, int], pd.Series]:
    """Mean features by (region, reconstruction, dose); the mean HU is that at the fitted dose."""
    found = {}
    for roi, model in models.items():
        pairs = list(stream_pairs(named(stream, "prediction", roi), realizations, 1))
        for name in RECONSTRUCTIONS:
            mean = real[roi, name, FITTED].mean[MEAN]
            for dose in DOSES:
                found[roi, name, dose] = scanner.features(model, regions[roi], mean, name, dose, pairs).mean()
    return found


def interpolated(real: dict, model: dict | None = None) -> dict[tuple[str, str, int], pd.Series]:
    """Features at 3 mGy, linear in log dose between 1 and 10 mGy; with a model, its residuals are interpolated."""
    weight = np.log(3) / np.log(10)
    found = {}
    for roi, name, dose in real:
        if dose == 3:
            ends = [real[roi, name, end].mean - (model[roi, name, end] if model else 0) for end in (1, 10)]
            found[roi, name, 3] = (1 - weight) * ends[0] + weight * ends[1] + (model[roi, name, 3] if model else 0)
    return found


def shares(predicted: dict, real: dict) -> pd.DataFrame:
    """Percent of features within one repeat SD, a row per prediction (region, reconstruction, dose)."""
    rows = [
        {
            "roi": roi,
            "reconstruction": name,
            "dose": dose,
            "percent": 100 * ((values - real[roi, name, dose].mean).abs() < real[roi, name, dose].sd).mean(),
        }
        for (roi, name, dose), values in predicted.items()
    ]
    return pd.DataFrame(rows)


def order(predicted: dict, real: dict, name: str, dose: int) -> pd.Series:
    """Spearman's coefficient over the regions between predicted and measured values, by feature."""
    rois = sorted({roi for roi, _, _ in real})
    tables = [
        pd.DataFrame([(values[roi, name, dose]) for roi in rois], index=rois)
        for values in (predicted, {key: known.mean for key, known in real.items()})
    ]
    return roi_profiles.compare_profiles(*tables).set_index("feature")["order"]


def add_arguments(parser):
    parser.add_argument("--parameters", type=Path)


def run(options):
    real, regions, stream = series(), masks(), root(SEED)
    if options.parameters and options.parameters.exists():
        kept = json.loads(options.parameters.read_text(encoding="utf-8"))
        noise = {name: NoiseModel(**values) for name, values in kept["noise"].items()}
        pattern = Component(**kept["pattern"])
        models = {
            roi: RegionModel(**values | {key: Component(**values[key]) for key in ("fine", "coarse")})
            for roi, values in kept["regions"].items()
        }
    else:
        noise, models, pattern = fit(real, regions, stream)
        if options.parameters:
            kept = {"noise": {k: asdict(v) for k, v in noise.items()}, "pattern": asdict(pattern)}
            kept["regions"] = {k: asdict(v) for k, v in models.items()}
            options.parameters.write_text(json.dumps(kept, indent=1), encoding="utf-8")
    scanner = make_scanner(noise, pattern, real)
    for name, law in scanner.dose_law.items():
        print(name, "exponents", law.exponents(), "variances", law.variances)
    model = predict(scanner, models, regions, real, stream)
    ends = {key: known.mean for key, known in real.items() if key[2] == FITTED}
    predictions = {
        "unchanged from 10 mGy": {(*key[:2], dose): values for key, values in ends.items() for dose in DOSES},
        "log dose interpolation of 1 and 10 mGy": interpolated(real),
        "image model, 10 mGy": model,
        "image model, interpolator of 1 and 10 mGy": interpolated(real, model),
    }
    for title, predicted in predictions.items():
        table = shares(predicted, real)
        others = table[table["roi"] != UNIFORM]
        print(f"\n{title}\n", others.groupby(["dose", "reconstruction"])["percent"].mean().unstack().round(1))
        print(table.pivot(index="roi", columns=["dose", "reconstruction"], values="percent").round(0).to_string())
    for dose in DOSES:
        print(dose, {name: round(order(model, real, name, dose).mean(), 3) for name in RECONSTRUCTIONS})
