"""A pyradiomics table saved by other programs: the same values, or one line."""

import gzip
import logging

import numpy as np
import pandas as pd
import pytest
from pyradiomics_batch import LABELS, batch, scans

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.names import features_of
from virtual_phantom.features.table_files import read_table
from virtual_phantom.recordings.reading import load_recording


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The CSV of pyradiomics as text."""
    folder = tmp_path_factory.mktemp("scans")
    cases = [
        {"Image": path, "Mask": folder / "labels.nii.gz", "Label": label}
        for path in scans(folder, doses=(3,)).values()
        for label in LABELS.values()
    ]
    return batch(cases, folder / "t.csv").read_text()


@pytest.fixture
def table(written, tmp_path):
    (tmp_path / "t.csv").write_text(written)
    return pd.read_csv(tmp_path / "t.csv", dtype={"Label": str}).copy()


def saved(content, tmp_path, name="x.csv"):
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return tmp_path / name


def semicolons(table):
    return table.to_csv(sep=";", decimal=",", index=False)


def spaced(text):
    """Column names as written by spreadsheets and people."""
    head, _, rest = text.partition("\n")
    return ", ".join(f" {name} " for name in head.upper().split(",")) + "\n" + rest


VARIANTS = {
    "as pyradiomics writes it": lambda text, table: text,
    "semicolons and decimal commas": lambda text, table: semicolons(table),
    "semicolons and points": lambda text, table: table.to_csv(sep=";", index=False),
    "tabs": lambda text, table: table.to_csv(sep="\t", index=False),
    "vertical bars": lambda text, table: table.to_csv(sep="|", index=False),
    "everything quoted": lambda text, table: table.to_csv(index=False, quoting=1),
    "sep= of Excel": lambda text, table: "sep=;\r\n" + semicolons(table).replace("\n", "\r\n"),
    "byte order mark and sep=": lambda text, table: b"\xef\xbb\xbfsep=,\n" + text.encode(),
    "UTF-16": lambda text, table: semicolons(table).encode("utf-16"),
    "UTF-16 without a mark": lambda text, table: text.encode("utf-16-le"),
    "carriage returns of an old Mac": lambda text, table: text.replace("\n", "\r"),
    "blank lines": lambda text, table: "\n\n" + text.replace("\n", "\n\n"),
    "rows of separators": lambda text, table: text + "," * len(table.columns) + "\n",
    "empty columns at the end": lambda text, table: "\n".join(f"{line},,," for line in text.splitlines()),
    "a comma at the end of every row": lambda text, table: text.replace("\n", ",\n").replace(",\n", "\n", 1),
    "comments": lambda text, table: "# our cohort, first reader\n" + text + "# end\n",
    "the header of NumPy": lambda text, table: "# " + text,
    "numbers of the rows": lambda text, table: table.to_csv(),
    "names in capitals and spaces": lambda text, table: spaced(text),
    "names without the image type": lambda text, table: text.replace("original_", ""),
    "names with points": lambda text, table: text.replace("original_", "original."),
    "compressed": lambda text, table: gzip.compress(text.encode()),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_dialect_gives_the_same_values(written, table, tmp_path, variant):
    found = read_table(saved(VARIANTS[variant](written, table), tmp_path))
    features = features_of(table)
    np.testing.assert_array_equal(found[features], table[features])
    for name in ("Image", "Mask", "Label", "diagnostics_Configuration_Settings"):
        assert found[name].tolist() == table[name].tolist()


def test_skipped_and_renamed_columns_are_noted(written, table, tmp_path, caplog):
    changed = {
        "comments": "# 1\n# 2\n" + written,
        "numbers": table.to_csv(),
        "names": written.replace("original_glcm", "glcm"),
    }
    for name, content in changed.items():
        read_table(saved(content, tmp_path, f"{name}.csv"))
    assert [record.getMessage().partition(".csv: ")[2] for record in caplog.records] == [
        "2 comment lines skipped",
        "a column without a name was skipped",
        "24 columns read under the names of pyradiomics (glcm_Autocorrelation as original_glcm_Autocorrelation)",
    ]
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


def test_names_of_filters(written, tmp_path):
    for prefix, kind in (("wavelet_LLH", "wavelet-LLH"), ("log.sigma.1.0.mm.3D", "log-sigma-1-0-mm-3D")):
        found = read_table(saved(written.replace("original_glcm", f"{prefix}_glcm"), tmp_path))
        assert f"{kind}_glcm_Idmn" in found and "original_glszm_ZoneEntropy" in found


def with_entry(table, column, entry, row=1):
    return table.astype({column: object}).assign(**{column: [*table[column][:row], entry, *table[column][row + 1 :]]})


CONTRAST = "original_glcm_Contrast"
REFUSED = {
    "Excel": (lambda text, table: b"PK\x03\x04" + bytes(60), "is an Excel workbook or another ZIP archive; save"),
    "old Excel": (lambda text, table: b"\xd0\xcf\x11\xe0\xa1", "is an Excel workbook; save the table as CSV"),
    "Mac": (lambda text, table: b"\x00\x05\x16\x07\x00\x02\x00", "an AppleDouble file with attributes of another file"),
    "JSON": (lambda text, table: '{"original_glcm_Id": 1}', "is JSON; write one row per image and ROI as CSV"),
    "binary": (lambda text, table: bytes(range(256)), "is not UTF-8 text; save the table as CSV UTF-8"),
    "Windows": (lambda text, table: text.replace("r1.nii", "r\xe4.nii").encode("cp1252"), "line 4 is not UTF-8 text"),
    "blanks alone": (lambda text, table: " \n\n", "cannot be read as CSV (it is empty)"),
    "a title": (lambda text, table: "My cohort\n" + text, "its first line does not hold the names of several columns"),
    "an open quote": (lambda text, table: text + '"a', "cannot be read as CSV (line 8: unexpected end of data)"),
    "transposed": (lambda text, table: table.T.to_csv(), "is transposed: each row is a feature; write one row per"),
    "a dictionary": (lambda text, table: table.iloc[0].to_csv(), "is transposed: each row is a feature"),
    "long form": (lambda text, table: table.melt(id_vars=["Image", "Label"]).to_csv(), "is in long form: each row is"),
    "row names of R": (
        lambda text, table: table.to_csv().removeprefix(","),
        "every row has one field more than the header, 133 and 132; name the first column",
    ),
    "cut off": (
        lambda text, table: text[:-300],
        " fields and the header 132; is a value missing, or was the file cut off?",
    ),
    "two rows in one": (
        lambda text, table: "".join(text.splitlines(keepends=True)[:3]).rstrip() + "," + text.splitlines()[3],
        "row 3 has 264 fields and the header 132; are several rows in one line?",
    ),
    "a title between separators": (
        lambda text, table: "My cohort,,\n" + text,
        "row 2 has 132 fields and the header 3 (and 6 more rows); is the first line a title? Delete the lines before",
    ),
    "a second table": (lambda text, table: "\n\n" + text + text, "row 10 repeats the column names"),
    "one name twice": (
        lambda text, table: table.assign(glcm_Contrast=1).to_csv(index=False),
        f"the column '{CONTRAST}' occurs twice",
    ),
    "separators of thousands": (
        lambda text, table: with_entry(table, CONTRAST, "1,061,670").to_csv(sep=";", index=False),
        f"{CONTRAST} is '1,061,670' in row 3; save the table without thousands separators",
    ),
    "two decimal signs": (
        lambda text, table: with_entry(table, CONTRAST, "7,5").to_csv(index=False),
        f"{CONTRAST} is '7,5' in row 3 and original_shape_Elongation is '",
    ),
    "7,678": (
        lambda text, table: table[["Image"]].assign(**{CONTRAST: "7,678"}).to_csv(sep=";", index=False),
        f"{CONTRAST} is '7,678' in row 2, which may be a decimal comma or not",
    ),
    "a date": (
        lambda text, table: with_entry(table, CONTRAST, "01. Mai").to_csv(index=False),
        f"{CONTRAST} holds text ('01. Mai' in row 3); give numbers",
    ),
    "digits that Python groups": (
        lambda text, table: with_entry(table, CONTRAST, "1_000").to_csv(index=False),
        f"{CONTRAST} holds text ('1_000' in row 3)",
    ),
}


@pytest.mark.parametrize("variant", REFUSED)
def test_ambiguous_and_unreadable_tables_are_one_line(written, table, tmp_path, variant):
    change, message = REFUSED[variant]
    path = saved(change(written, table), tmp_path)
    with pytest.raises(InputError) as error:
        read_table(path)
    assert message in str(error.value), str(error.value)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


NAMES = ["01", "NA", "true", "1e3", "null", "None", "nan", "inf", "-", "1.0", "a b", 'x"y', "p,q", "\u00fcber", "007"]


def test_images_keep_their_names(written, table, tmp_path):
    named = pd.concat([table] * 3, ignore_index=True).iloc[: len(NAMES)].assign(Image=NAMES, Mask=NAMES, reader=NAMES)
    for separator in ",;\t":
        found = read_table(saved(named.to_csv(sep=separator, index=False), tmp_path))
        assert found["Image"].tolist() == found["Mask"].tolist() == found["reader"].tolist() == NAMES


def test_recording_of_a_saved_table(written, table, tmp_path):
    """Conditions keep their leading zeros; rows are counted as in the file."""
    conditions = table.assign(site=["007"] * 3 + ["08"] * 3, dose=[3, 3, 3, 10, 10, 10])
    rois = "[{name: liver, tissue_class: liver, label: 1}]"
    (tmp_path / "recording.yaml").write_text(
        f"name: r\nkind: features\nrepeats: [x.csv]\nrois: {rois}\nfeatures: {{conditions: [site, dose]}}"
    )
    saved("# by site\n" + semicolons(conditions), tmp_path)
    recording = load_recording(tmp_path)
    assert recording.repeats["site"].tolist() == ["007", "007", "08"] and recording.repeats["dose"].tolist() == [
        3,
        3,
        10,
    ]
    saved("# by site\n" + semicolons(conditions.assign(Image=[None, *table["Image"][1:]])), tmp_path)
    with pytest.raises(InputError, match="x.csv: image is empty in row 3"):
        load_recording(tmp_path)
