import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError
from virtual_phantom.features import tables
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.io import files

ROIS = {"normal_1": "normal_liver", "cyst_1": "cyst", "metastasis": "metastasis"}


def image_table(protocol="sirt_150", noise="dose_10mgy", seed=0):
    rng = np.random.default_rng([seed, len(protocol), len(noise)])
    extracted = pd.DataFrame(
        {
            "roi": list(ROIS),
            "n_voxels": 100,
            "grey_levels": 5,
            "settings_hash": "0e12",
            "pyradiomics_version": "3",
            "numpy_version": "2.10",
            "simpleitk_version": "2",
            **{feature: rng.normal(size=3) * 10.0 ** rng.integers(-20, 20, 3) for feature in FEATURES},
        }
    )
    acquisition = {
        "protocol": protocol,
        "algorithm": "SIRT",
        "projections": 150,
        "noise": noise,
        "noise_level": 1e-4,
        "seed": seed,
    }
    return tables.add_acquisition(extracted, ROIS, acquisition)


TABLES = [
    image_table(protocol, noise, seed)
    for protocol in ("sirt_200", "fbp_150")
    for noise in ("low", "dose_1")
    for seed in (0, 2, 10)
]


def test_columns_have_the_documented_order():
    assert list(image_table().columns) == [
        "protocol",
        "algorithm",
        "projections",
        "noise",
        "noise_level",
        "seed",
        "roi",
        "tissue_class",
        "n_voxels",
        "grey_levels",
        "settings_hash",
        "pyradiomics_version",
        "numpy_version",
        "simpleitk_version",
        *FEATURES,
    ]
    assert list(image_table()["tissue_class"]) == ["normal_liver", "cyst", "metastasis"]


def test_written_and_read_bit_for_bit(tmp_path):
    path = tmp_path / "table.csv"
    files.write_csv(image_table(), path)
    back = tables.read_features(path)
    pd.testing.assert_frame_equal(back, image_table(), check_exact=True)
    files.write_csv(back, tmp_path / "again.csv")
    assert path.read_bytes() == (tmp_path / "again.csv").read_bytes()


@settings(max_examples=15, deadline=None)
@given(st.permutations(TABLES))
def test_order_of_files_has_no_effect(shuffled):
    merged = tables.merge_tables(shuffled)
    assert merged.equals(tables.merge_tables(TABLES))
    assert len(merged) == 36
    keys = merged[["protocol", "noise", "seed"]].drop_duplicates().values.tolist()
    assert keys == sorted(keys) and keys[0] == ["fbp_150", "dose_1", 0]
    assert list(merged["roi"]) == list(ROIS) * 12  # order of the tables, not of the alphabet


def test_selecting_takes_the_first_seeds():
    merged = tables.merge_tables(TABLES)
    chosen = tables.select(merged, protocols=["fbp_150"], noise=["low"], seeds=2)
    assert sorted(chosen["seed"].unique()) == [0, 2] and len(chosen) == 6
    assert set(chosen["protocol"]) == {"fbp_150"} and set(chosen["noise"]) == {"low"}


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda: tables.merge_tables([TABLES[0], TABLES[0]]),
            "two rows for protocol sirt_200, noise low, seed 0, roi normal_1",
        ),
        (
            lambda: tables.merge_tables([TABLES[0], TABLES[1].assign(settings_hash="other")]),
            "different settings_hash",
        ),
        (lambda: tables.merge_tables([TABLES[0].iloc[:1], TABLES[1]]), "ROI cyst_1 is not in every image"),
        (lambda: tables.merge_tables([TABLES[0], TABLES[1].iloc[:1]]), "ROI cyst_1 is not in every image"),
        (
            lambda: tables.select(tables.merge_tables(TABLES), protocols=["fbp_150"], noise=["low"], seeds=4),
            "3 seeds for protocol fbp_150, noise low; 4 are needed",
        ),
        (
            lambda: tables.select(tables.merge_tables(TABLES), protocols=["mlem"], noise=["low"], seeds=1),
            "0 seeds for protocol mlem",
        ),
        (lambda: tables.read_features("/nowhere/features.csv"), "/nowhere/features.csv: no such file"),
        (
            lambda: tables.finite_values(TABLES[0].assign(**{FEATURES[4]: np.nan}), FEATURES, "features.csv"),
            "features.csv: original_firstorder_InterquartileRange is nan for protocol sirt_200",
        ),
        (
            lambda: tables.finite_values(TABLES[0].assign(**{FEATURES[4]: "1.2.3"}), FEATURES, "features.csv"),
            "features.csv: original_firstorder_InterquartileRange is 1.2.3 for protocol sirt_200",
        ),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with pytest.raises(InputError) as caught:
        call()
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_table_without_a_feature_is_rejected(tmp_path):
    files.write_csv(image_table().drop(columns=FEATURES[5]), tmp_path / "short.csv")
    with pytest.raises(InputError, match=f"short.csv: lacks 1 column.*{FEATURES[5]}"):
        tables.read_features(tmp_path / "short.csv")
