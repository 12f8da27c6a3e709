import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.statistics import pca

ROIS = {"normal_1": "normal_liver", "cyst_1": "cyst", "metastasis": "metastasis"}


def simulated(seed=0, features=FEATURES[:6], spread=1.0, protocols=("a", "b")):
    """Random features around a center per ROI, for several repeats of several protocols."""
    rng = np.random.default_rng(seed)
    centres = {roi: rng.normal(0, 3, len(features)) for roi in ROIS}
    return pd.DataFrame(
        [
            {
                "protocol": protocol,
                "algorithm": "SIRT",
                "projections": 150,
                "noise": "dose",
                "noise_level": 1e-4,
                "seed": repeat,
                "roi": roi,
                "tissue_class": name,
                **dict(zip(features, centres[roi] + spread * rng.normal(size=len(features)), strict=True)),
            }
            for protocol in protocols
            for repeat in range(4)
            for roi, name in ROIS.items()
        ]
    )


def measured_table(seed=7, features=FEATURES[:6]):
    table = simulated(seed, features)
    return table.assign(group=table["seed"] + 1)[["group", "roi", "tissue_class", *features]]


def plane(points, source=None):
    points = points if source is None else points[points["source"] == source]
    return points[["pc1", "pc2"]].to_numpy(dtype=float)


def test_two_features_in_closed_form():
    # Two standardized features with correlation r have components along (1, 1) and (1, -1), of variance 1 + r and 1 -
    # r. Here (0, 1, 2, 3) and (0, 2, 1, 3): r = 4/5.
    table = (
        simulated(features=FEATURES[:2]).iloc[:4].assign(**{FEATURES[0]: [0.0, 1, 2, 3], FEATURES[1]: [0.0, 2, 1, 3]})
    )
    points = pca.project(table)
    assert points.loc[0, ["explained_pc1_percent", "explained_pc2_percent"]].tolist() == pytest.approx([90, 10])
    standard = (np.array([0, 1, 2, 3]) - 1.5) / np.sqrt(1.25)
    other = standard[[0, 2, 1, 3]]
    assert points["pc1"].tolist() == pytest.approx(((standard + other) / np.sqrt(2)).tolist())


@settings(max_examples=20, deadline=None)
@given(scale=st.floats(1e-3, 1e3), shift=st.floats(-1e3, 1e3), which=st.integers(0, 5), seed=st.integers(0, 50))
def test_unit_of_a_feature_has_no_effect(scale, shift, which, seed):
    table = simulated(seed)
    changed = table.assign(**{FEATURES[which]: scale * table[FEATURES[which]] + shift})
    assert np.allclose(plane(pca.project(table)), plane(pca.project(changed)), atol=1e-6)


def test_order_of_rows_has_no_effect():
    table = simulated()
    order = np.random.default_rng(1).permutation(len(table))
    assert np.allclose(plane(pca.project(table))[order], plane(pca.project(table.iloc[order])))


def test_components_are_centered_uncorrelated_and_have_their_variance():
    points = pca.project(simulated())
    covariance = np.cov(plane(points).T, ddof=0)
    assert np.allclose(plane(points).mean(axis=0), 0)
    assert covariance[0, 1] == pytest.approx(0, abs=1e-12)
    share = points.loc[0, ["explained_pc1_percent", "explained_pc2_percent"]].to_numpy(dtype=float) / 100
    assert np.diag(covariance) == pytest.approx(6 * share)  # six standardized features have a total variance of six


def test_separate_standardization_hides_offsets_and_joint_standardization_shows_them():
    table, reference = simulated(), measured_table()
    moved = reference.assign(**{feature: 10 * reference[feature] + 500 for feature in FEATURES[:6]})
    each = [plane(pca.project(table, other), "measured") for other in (reference, moved)]
    assert np.allclose(*each)
    together = [plane(pca.project(table, other, standardise="together"), "measured") for other in (reference, moved)]
    assert np.abs(together[1] - together[0]).max() > 100


def test_fitted_set_determines_the_axes():
    table, reference = simulated(), measured_table()
    fits = {fit_on: pca.project(table, reference, fit_on=fit_on, standardise="together") for fit_on in pca.FIT_ON}
    assert np.allclose(plane(fits["simulated"], "simulated"), plane(pca.project(table)))
    swapped = pca.project(table.assign(**{feature: reference[feature] for feature in FEATURES[:6]}))
    assert np.allclose(plane(fits["measured"], "measured"), plane(swapped))
    assert np.allclose(plane(fits["pooled"]).mean(axis=0), 0)
    assert len({fit.loc[0, "explained_pc1_percent"] for fit in fits.values()}) == 3


def test_features_of_one_set_only_are_excluded_and_columns_keep_their_types(tmp_path):
    table = simulated(features=FEATURES[:6])
    reference = measured_table(features=FEATURES[:4])
    points = pca.project(table, reference)
    assert np.allclose(plane(points, "simulated"), plane(pca.project(table.drop(columns=list(FEATURES[4:6])))))
    path = tmp_path / "points.csv"
    points.to_csv(path, index=False)
    lines = path.read_text().splitlines()
    assert lines[0] == (
        "source,protocol,algorithm,projections,noise,noise_level,seed,group,roi,tissue_class,pc1,pc2,"
        "explained_pc1_percent,explained_pc2_percent"
    )
    assert lines[1].startswith("simulated,a,SIRT,150,dose,0.0001,0,,normal_1,normal_liver,")
    assert lines[len(table) + 1].startswith("measured,,,,,,,1,normal_1,normal_liver,")


def test_separable_classes_are_separated_and_random_labels_are_not():
    good = pca.separability(pca.project(simulated(spread=0.01), measured_table()), "demo")
    assert list(good["source"]) == ["simulated", "measured"]
    assert good.loc[0, ["pca", "left_out", "accuracy", "n"]].tolist() == ["demo", "setting", 1.0, 24]
    assert good.loc[0, "largest_class"] == pytest.approx(1 / 3)
    rng = np.random.default_rng(2)
    points = pca.project(simulated(spread=1, protocols=range(20)))
    random = points.assign(tissue_class=rng.permutation(points["tissue_class"]))
    assert pca.separability(random, "demo")["accuracy"][0] == pytest.approx(1 / 3, abs=0.15)


def test_points_are_not_classified_by_repeats_of_their_own_setting():
    # Two settings with opposite class order: only repeats of a setting predict its classes.
    rows = [
        {
            "source": "simulated",
            "protocol": str(setting),
            "noise": "n",
            "group": None,
            "seed": seed,
            "tissue_class": "ab"[(k + setting) % 2],
            "pc1": 10.0 * setting + 100 * k + (seed - 2) ** 2,
            "pc2": 0.1 * seed,
        }
        for setting in range(2)
        for k in range(2)
        for seed in range(5)
    ]
    assert pca.separability(pd.DataFrame(rows), "demo")["accuracy"][0] == 0
    single = pca.separability(pd.DataFrame([row for row in rows if row["protocol"] == "0"]), "demo")
    assert single.loc[0, ["left_out", "accuracy"]].tolist() == ["repeat", 1.0]


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda: pca.project(simulated(), fit_on="both"),
            "pca.fit_on: 'both' is not known; choose from simulated",
        ),
        (
            lambda: pca.project(simulated(), standardise="no"),
            "pca.standardise: 'no' is not known; choose from each",
        ),
        (
            lambda: pca.project(simulated(), fit_on="measured"),
            "pca.fit_on: 'measured' needs measured features",
        ),
        (lambda: pca.project(simulated().iloc[:1]), "1 rows and 6 features"),
        (
            lambda: pca.project(simulated().assign(**{FEATURES[2]: np.inf})),
            f"simulated features: {FEATURES[2]} is inf",
        ),
        (
            lambda: pca.separability(pca.project(simulated()).query("roi == 'cyst_1'"), "x"),
            "at least two tissue classes",
        ),
        (
            lambda: pca.separability(pca.project(simulated().query("seed == 0")), "x"),
            "pca x: without one setting there are no more simulated points than tissue classes",
        ),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with pytest.raises(InputError) as caught:
        call()
    assert message in str(caught.value) and "\n" not in str(caught.value)
