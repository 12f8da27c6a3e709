"""Predict features of the printed phantom at other doses, and compare them with measured ones (4 minutes).

The image model (virtual_phantom.image_model) is fitted to the features of the dose series at 10 mGy. At 1 and 3 mGy,
only the variance of the large cyst is used. Prints the share of features within one repeat SD of the measured means,
by dose, reconstruction and region, and the order of the regions, each with simpler predictions. Parameters come from
edge_scanner_model.json of the library; --fit FILE fits them again (15 minutes) and writes them to FILE.
"""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.common.perturbation import perturb, signed_distance
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import Stream, generator, named, root
from virtual_phantom.features.names import FEATURES, MEAN, VARIANCE
from virtual_phantom.features.parameters import DEFAULT
from virtual_phantom.features.table_files import read_table
from virtual_phantom.image_model.dose import DoseLaw
from virtual_phantom.image_model.fitting import Measured, fit_noise, fit_region
from virtual_phantom.image_model.noise import NoiseModel
from virtual_phantom.image_model.region import Blur, RegionModel
from virtual_phantom.image_model.scanner import ImageScanner, features_of
from virtual_phantom.io.files import read_csv
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.phantom.texture import Component, Texture
from virtual_phantom.statistics import dose_series, measured

SEED = 51
SPACING = (1.0, 0.684, 0.684)  # mm, of the dose series
GRID = Grid((170, 310, 430), SPACING)
MARGIN = 8  # voxels, for perturbations
FITTED, DOSES = 10, (1, 3, 10)  # mGy
LEVELS = {"mgy1": 1, "mgy3": 3, "mgy10": 10}  # of the default study
REPEATS = 6  # of each control
PREDICTED = 100  # number of the first noise realization of a prediction; fits use those from 0
UNIFORM = "cyst_1"
RECONSTRUCTIONS = ("fbp", "iterative")
BLUR = Blur(2.98, 5.06, 0.85)  # kernel with which textures were fitted; a slice of 2 mm
REALIZATIONS = {"hemangioma": 2, "metastasis": 4}  # of noise while fitting, others SMALL
SMALL = 8
START_NOISE = {"fbp": NoiseModel(2.6, 4.8, 0.15, 0.75, 0.1), "iterative": NoiseModel(2.0, 4.3, 0.25, 0.65, 0.15)}
START = {
    "cyst_2": RegionModel(1.2, Component(2, 3, 0.3), Component(2, 8)),
    "hemangioma": RegionModel(1.1, Component(15, 2.0, 1.6), Component(6, 8)),
    "metastasis": RegionModel(1.1, Component(9, 2.0, 0.6), Component(6, 8)),
    "normal_1": RegionModel(1.1, Component(13, 1.6, 1.4), Component(5, 8)),
    "normal_2": RegionModel(1.1, Component(7, 1.6, 1.4), Component(4, 8)),
}


def masks() -> dict[str, np.ndarray]:
    """Regions of the drawn phantom on the scanner's voxels, each cropped to its bounding box."""
    found = {}
    for roi in synthetic.rois(layout.read_layout(), GRID, root(SEED)):
        found[roi.name] = roi.mask[tuple(slice(i.min(), i.max() + 1) for i in np.nonzero(roi.mask))]
    return found


def series() -> dict[tuple[str, str, int], Measured]:
    """Measured features by (region, reconstruction, dose)."""
    table = read_csv(dose_series.TABLE)
    return {
        key: Measured(rows["mean"].reindex(FEATURES), rows["sd"].reindex(FEATURES))
        for key, rows in table.set_index("feature").groupby(["roi", "reconstruction", "dose_mgy"])
    }


def fit(real: dict, regions: dict[str, np.ndarray], stream: Stream) -> tuple[dict, dict, Component]:
    """Noise by reconstruction, model by region, and the pattern of the uniform region, fitted at one dose."""
    noise, pattern = {}, None
    for name in RECONSTRUCTIONS:
        known = real[UNIFORM, name, FITTED]
        region, start = named(stream, UNIFORM), START_NOISE[name]
        noise[name], pattern = fit_noise(known, regions[UNIFORM], SPACING, region, pattern=pattern, start=start)
        print(name, noise[name], pattern, flush=True)
    scanner = make_scanner(noise, pattern, real)
    models = {UNIFORM: RegionModel(1.0, Component(0.0, 1.0), pattern)}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        jobs = {
            roi: pool.submit(
                fit_region,
                scanner,
                {name: real[roi, name, FITTED] for name in RECONSTRUCTIONS},
                FITTED,
                regions[roi],
                start,
                named(stream, roi),
                realizations=REALIZATIONS.get(roi, SMALL),
            )
            for roi, start in START.items()
        }
        for roi, job in jobs.items():
            models[roi] = job.result()
            print(roi, models[roi], flush=True)
    return noise, models, pattern


def parameters(path: Path = RESOURCES / "edge_scanner_model.json") -> tuple[dict, dict, Component]:
    """Read what `fit` returns."""
    kept = json.loads(path.read_text(encoding="utf-8"))
    noise = {name: NoiseModel(**values) for name, values in kept["noise"].items()}
    models = {
        roi: RegionModel(**values | {key: Component(**values[key]) for key in ("fine", "coarse")})
        for roi, values in kept["regions"].items()
    }
    return noise, models, Component(**kept["pattern"])


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
        noises = range(PREDICTED, PREDICTED + realizations)
        for name in RECONSTRUCTIONS:
            mean = real[roi, name, FITTED].mean[MEAN]
            for dose in DOSES:
                found[roi, name, dose] = scanner.features(
                    model, regions[roi], mean, name, dose, named(stream, roi), noises
                ).mean()
    return found


def drawn_regions(stream: Stream, margin: int = 0) -> dict[str, np.ndarray]:
    """The drawn phantom without a scan: HU of each region's tissue on its bounding box and a margin, in voxels."""
    drawn = layout.read_layout()
    found = {}
    for roi in synthetic.rois(drawn, GRID, stream):
        (entry,) = (entry for entry in drawn["rois"] if entry["name"] == roi.name)
        tissue = drawn["tissues"][entry["tissue"]]
        components = tuple(Component(**component) for component in tissue.get("texture", ()))
        texture = Texture(components, entry["tissue"], stream)
        axes = [
            axis[i.min()] + step * np.arange(-margin, i.max() - i.min() + 1 + margin)
            for axis, i, step in zip(GRID.axes_mm(), np.nonzero(roi.mask), SPACING, strict=True)
        ]
        found[roi.name] = np.float32(tissue["hu"]) + texture.sample(*axes)
    return found


def with_noise(real: dict, regions: dict, stream: Stream, noise: dict[str, NoiseModel] | None, repeats: int) -> dict:
    """Features of the drawn phantom with noise of the large cyst's variance: white, or with the fitted spectrum."""
    found = {}
    textures = [drawn_regions(named(stream, "texture", repeat)) for repeat in range(repeats)]
    for roi, mask in regions.items():
        for name in RECONSTRUCTIONS:
            fields = [
                noise[name].sample(mask.shape, SPACING, named(stream, "noise", roi, repeat))
                if noise
                else generator(named(stream, "noise", roi, repeat)).standard_normal(mask.shape, np.float32)
                for repeat in range(repeats)
            ]
            for dose in DOSES:
                sd = np.sqrt(real[UNIFORM, name, dose].mean[VARIANCE])
                images = (texture[roi] + sd * field for texture, field in zip(textures, fields, strict=True))
                found[roi, name, dose] = features_of(images, mask, SPACING).mean()
    return found


def perturbed(regions: dict, stream: Stream, repeats: int) -> dict:
    """Features of the clean drawn phantom after random perturbations (benchmarks/common/perturbation.py)."""
    found = {}
    textures = [drawn_regions(named(stream, "texture", repeat), MARGIN) for repeat in range(repeats)]
    for roi, mask in regions.items():
        distance = signed_distance(np.pad(mask, MARGIN), SPACING)
        rows = []
        for repeat, texture in enumerate(textures):
            random = generator(named(stream, "perturbation", roi, repeat))
            image, changed = perturb(texture[roi], distance, random)
            rows.append(features_of([image], changed, SPACING))
        values = pd.concat(rows).mean()
        found |= {(roi, name, dose): values for name in RECONSTRUCTIONS for dose in DOSES}
    return found


def read_studies(paths: list[Path]) -> pd.DataFrame:
    """3D features of the default study at the doses of the series, with the columns reconstruction and dose."""
    tables = pd.concat(map(read_table, paths))
    if set(tables["settings_hash"]) != {DEFAULT.hash()}:
        raise InputError(f"{paths[0]}: has other features than 3D features in HU; use config/whole_regions.yaml")
    protocols = {"group_2": "fbp", "group_1": "iterative"}
    kept = tables[tables["protocol"].isin(protocols)]
    return kept.assign(reconstruction=kept["protocol"].map(protocols), dose=kept["noise"].map(LEVELS))


def over_repeats(studies: pd.DataFrame, real: dict, feature: str) -> pd.DataFrame:
    """Mean and SD over repeats of a feature in each region, simulated and measured."""
    rows = studies.groupby(["dose", "reconstruction", "roi"])[feature].agg(["mean", "std"])
    known = [real[roi, name, dose] for dose, name, roi in rows.index]
    rows["measured mean"] = [one.mean[feature] for one in known]
    rows["measured SD"] = [one.sd[feature] for one in known]
    return rows.round(2)


def interpolated(real: dict, model: dict | None = None) -> dict[tuple[str, str, int], pd.Series]:
    """Features at 3 mGy, linear in log dose between 1 and 10 mGy; with a model, its residuals are interpolated."""
    weight = np.log(3) / np.log(10)
    found = {}
    for roi, name, dose in real:
        if dose == 3:
            ends = [real[roi, name, end].mean - (model[roi, name, end] if model else 0) for end in (1, 10)]
            found[roi, name, 3] = (1 - weight) * ends[0] + weight * ends[1] + (model[roi, name, 3] if model else 0)
    return found


def halves(table: pd.DataFrame, stream: Stream, draws: int = 20) -> pd.DataFrame:
    """Percent of features whose means over two halves of the repeats differ by less than one SD, by dose."""
    random, rows = generator(stream), []
    keys = ["dose_mgy", "reconstruction", "roi"]
    for key, repeats in table[table["roi"] != UNIFORM].groupby(keys)[list(FEATURES)]:
        for _ in range(draws):
            order = random.permutation(len(repeats))
            means = [repeats.iloc[part].mean() for part in np.array_split(order, 2)]
            share = ((means[0] - means[1]).abs() < repeats.std()).mean()
            rows.append(dict(zip(keys, key, strict=True)) | {"percent": 100 * share})
    return pd.DataFrame(rows).groupby(keys[:2])["percent"].mean().unstack().round(1)


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
    """Spearman's coefficient over the regions between predicted and measured values, by feature; 0 for constants."""
    rois = sorted({roi for roi, _, _ in real})
    ranks, measured_ranks = (
        pd.DataFrame([(values[roi, name, dose]) for roi in rois], index=rois).rank()
        for values in (predicted, {key: known.mean for key, known in real.items()})
    )
    return ranks.corrwith(measured_ranks).fillna(0)


def forecast(scanner, models, regions, real, stream, doses=(6, 14), realizations: int = 24) -> pd.DataFrame:
    """Means and repeat SDs at doses that are not measured here, with the model's residuals at the known doses.

    Residuals are linear in log dose between the nearest known doses and constant beyond 10 mGy. The SD is that over
    noise realizations, times the median over features of measured over simulated SD at 10 mGy.
    """
    region_names = {roi: name for name, roi in measured.DOSE_ROIS.items()}
    rows = []
    for roi, model in models.items():
        noises = range(PREDICTED, PREDICTED + realizations)
        for name in RECONSTRUCTIONS:
            tables = {}
            for dose in (3, FITTED, *doses):
                mean = real[roi, name, FITTED].mean[MEAN]
                tables[dose] = scanner.features(model, regions[roi], mean, name, dose, named(stream, roi), noises)
            sds = {dose: table.std() for dose, table in tables.items()}
            scale = (real[roi, name, FITTED].sd / sds[FITTED]).median()
            residual = {dose: real[roi, name, dose].mean - tables[dose].mean() for dose in (3, FITTED)}
            for dose in doses:
                weight = np.clip(np.log(dose / 3) / np.log(FITTED / 3), 0, 1)
                means = tables[dose].mean() + (1 - weight) * residual[3] + weight * residual[FITTED]
                rows += [
                    {
                        "dose_mGy": dose,
                        "reconstruction": name,
                        "roi6": region_names[roi],
                        "feature": feature,
                        "mean": means[feature],
                        "sd": scale * sds[dose][feature],
                    }
                    for feature in FEATURES
                ]
    return pd.DataFrame(rows)


def add_arguments(parser):
    parser.add_argument("--seed", type=int, default=SEED, help=f"of textures and noise, with --fit (default {SEED})")
    parser.add_argument("--fit", type=Path, help="fit the parameters again and write them to this JSON file")
    parser.add_argument("--table", type=Path, help="features_3d.csv of the dose series: compare halves of its repeats")
    parser.add_argument("--study", type=Path, nargs="+", help="features.csv of default studies with 3D features")
    parser.add_argument("--forecast", type=Path, help="write the features at 6 and 14 mGy to this CSV file")


def run(options):
    if options.seed != SEED and not options.fit:
        raise InputError(
            f"--seed {options.seed}: the kept parameters belong to textures of seed {SEED}; add --fit FILE"
        )
    real, regions, stream = series(), masks(), root(options.seed)
    if options.fit:
        noise, models, pattern = fit(real, regions, stream)
        kept = {"noise": {k: asdict(v) for k, v in noise.items()}, "pattern": asdict(pattern)}
        kept["regions"] = {k: asdict(v) for k, v in models.items()}
        options.fit.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    else:
        noise, models, pattern = parameters()
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
    orders = {
        "image model": model,
        "white noise on the drawn phantom": with_noise(real, regions, named(stream, "white"), None, REPEATS),
        "fitted noise on the drawn phantom": with_noise(real, regions, named(stream, "fitted"), noise, REPEATS),
        "image perturbation of the drawn phantom": perturbed(regions, named(stream, "perturbed"), REPEATS),
    }
    print(order_table(orders, real, named(stream, "bootstrap")).to_string())
    if options.study:
        studies = read_studies(options.study)
        studied = dict(studies.groupby(["roi", "reconstruction", "dose"])[list(FEATURES)].mean().iterrows())
        table = shares(studied, real)
        means = table[table["roi"] != UNIFORM].groupby(["dose", "reconstruction"])["percent"].mean()
        print("\ndefault study, simulated scans\n", means.unstack().round(1))
        print(table.pivot(index="roi", columns=["dose", "reconstruction"], values="percent").round(0).to_string())
        for feature in (MEAN, VARIANCE):
            print(f"\n{feature} over repeats\n{over_repeats(studies, real, feature).to_string()}")
        if {key[2] for key in studied} == set(DOSES):
            print(order_table({"default study": studied}, real, named(stream, "bootstrap")).to_string())
    if options.table:
        table = measured.load_full_dose_series(options.table)
        print("\nhalf of the repeats against the other half\n", halves(table, named(stream, "halves")))
    if options.forecast:
        table = forecast(scanner, models, regions, real, stream)
        table.to_csv(options.forecast, index=False, lineterminator="\n", float_format="%.6g")


def order_table(predictions: dict, real: dict, stream: Stream) -> pd.DataFrame:
    """Mean order of the regions over features and reconstructions, by dose, and its difference from the image model.

    The intervals (2.5th to 97.5th percentile) are from features drawn again with replacement.
    """
    draws = generator(stream).integers(len(FEATURES), size=(2000, len(FEATURES)))
    rows, first = [], {}
    for title, predicted in predictions.items():
        for dose in DOSES:
            by_feature = np.mean([order(predicted, real, name, dose).reindex(FEATURES) for name in RECONSTRUCTIONS], 0)
            first.setdefault(dose, by_feature)
            difference = (first[dose] - by_feature)[draws].mean(axis=1)
            low, high = np.percentile(by_feature[draws].mean(axis=1), [2.5, 97.5])
            rows.append(
                {
                    "prediction": title,
                    "dose": dose,
                    "order": round(by_feature.mean(), 3),
                    "interval": f"{low:.3f} to {high:.3f}",
                    "below image model by at least": round(np.percentile(difference, 2.5), 3),
                }
            )
    return pd.DataFrame(rows).set_index(["prediction", "dose"])
