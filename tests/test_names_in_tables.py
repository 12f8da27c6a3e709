"""Names that look like numbers, truth values or gaps survive every table of a study."""

import ast
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.features import tables
from virtual_phantom.features.names import FEATURES
from virtual_phantom.io import files
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import Roi
from virtual_phantom.recordings.reference import select_rows

ROOT = Path(__file__).resolve().parents[1]
ODD = ["01", "NA", "true", "1e3", "null", "None", "nan", "inf", "1_0", "007", "False", "1", "NaN", "0x1F", "1E5"]
PRINTED = st.characters(exclude_categories=["Cc", "Cs"])  # the schemas allow no control characters
READERS = ("read_csv", "read_table", "read_fwf")
NAMES = st.text(PRINTED, min_size=1, max_size=12) | st.sampled_from(ODD)


def test_tables_are_read_by_two_functions_only():
    """Every CSV is read by io.files.read_csv or features.table_files.read_table, or as text by the module csv."""
    found = [
        str(path.relative_to(ROOT))
        for folder in ("workflow", "benchmarks", "docs")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if (text := path.read_text(encoding="utf-8")) and any(reader in text for reader in READERS)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute)
        and node.attr in READERS
        and isinstance(node.value, ast.Name)
        and node.value.id in ("pd", "pandas")
    ]
    assert found == ["workflow/lib/virtual_phantom/io/files.py"] * 2


@given(st.lists(NAMES, min_size=1, max_size=6), st.sampled_from(sorted(files.NAMES)))
@settings(max_examples=150, deadline=None)
def test_any_name_is_read_back(tmp_path_factory, names, column):
    path = tmp_path_factory.mktemp("t") / "t.csv"
    files.write_csv(pd.DataFrame({column: names, "value": np.arange(len(names)) / 7}), path)
    table = files.read_csv(path)
    assert table[column].tolist() == names
    np.testing.assert_array_equal(table["value"], np.arange(len(names)) / 7)


@pytest.mark.parametrize("name", sorted({*ODD} - {"False", "1", "inf"}))  # as pandas writes other types
def test_condition_of_any_name_stays_text(tmp_path, name):
    """Columns named by users, with unusual names only."""
    files.write_csv(pd.DataFrame({"site": [name] * 3, "x": [1, 2, 3]}), tmp_path / "t.csv")
    assert files.read_csv(tmp_path / "t.csv")["site"].tolist() == [name] * 3


def test_numbers_truth_values_and_gaps_keep_their_types(tmp_path):
    table = pd.DataFrame(
        {
            "whole": [1, -2, 10**12],
            "real": [1.0, 1e-7, 2.5e20],
            "infinite": [np.inf, -np.inf, 1.0],
            "gaps": [1.0, np.nan, 3.0],
            "empty": [np.nan] * 3,
            "flag": [True, False, True],
            "text": ["a", None, "NA"],
        }
    )
    files.write_csv(table, tmp_path / "t.csv")
    pd.testing.assert_frame_equal(files.read_csv(tmp_path / "t.csv"), table, check_exact=True)


def test_number_column_with_the_name_of_a_text_column(tmp_path):
    files.write_csv(pd.DataFrame({"noise": [1.5, 2.0]}), tmp_path / "t.csv")
    assert files.read_csv(tmp_path / "t.csv", numbers=["noise"])["noise"].tolist() == [1.5, 2.0]


def test_rows_longer_than_the_header_are_rejected(tmp_path):
    """pandas would use the first column as index."""
    (tmp_path / "t.csv").write_text("a,b\n1,2,3\n4,5,6\n")
    with pytest.raises(InputError, match="cannot be read as CSV"):
        files.read_csv(tmp_path / "t.csv")


def test_rois_of_a_phantom(tmp_path):
    grid = Grid((2, 3, len(ODD)), (1, 1, 1))
    masks = np.arange(len(ODD))[:, None, None, None] == np.arange(len(ODD))[None, None, None, :]
    rois = [
        Roi(name, ODD[-place - 1], np.broadcast_to(masks[place], grid.shape).copy(), ODD[place])
        for place, name in enumerate(ODD)
    ]
    phantom.write_rois(rois, Volume(np.zeros(grid.shape, np.float32), grid), tmp_path)
    found = phantom.read_rois(tmp_path / "rois.csv", grid)
    for one, other in zip(rois, found, strict=True):
        assert (one.name, one.tissue_class, one.label_in_file) == (other.name, other.tissue_class, other.label_in_file)
        np.testing.assert_array_equal(one.mask, other.mask)


def test_features_and_parquet(tmp_path):
    rows = {name: ODD for name in ("protocol", "algorithm", "noise", "roi", "tissue_class", *tables.PROVENANCE)}
    rows |= dict.fromkeys(("projections", "noise_level", "seed", "n_voxels", "grey_levels"), 1)
    table = pd.DataFrame(rows | {name: np.arange(len(ODD)) / 3 for name in FEATURES})
    files.write_csv(table, tmp_path / "features.csv")
    found = tables.read_features(tmp_path / "features.csv")
    files.write_parquet(found, tmp_path / "features.parquet")
    for one in (found, pd.read_parquet(tmp_path / "features.parquet")):
        assert all(one[name].tolist() == ODD for name in rows if rows[name] is ODD)


def test_text_condition_is_found_by_a_number_of_yaml():
    table = pd.DataFrame({"kernel": ["30", "30", "50"], "dose_mgy": [1, 3, 3]})
    assert select_rows(table, {"kernel": 30, "dose_mgy": 3}, "r").index.tolist() == [1]
    with pytest.raises(InputError, match="r: no images with kernel 40; choose from 30, 50"):
        select_rows(table, {"kernel": 40}, "r")
