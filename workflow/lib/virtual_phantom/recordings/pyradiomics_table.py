"""Conversion of the table that pyradiomics writes for a batch to the columns and names of a recording of features.

A row of that table is an image with a mask and perhaps a label. The section `rois` of recording.yaml assigns rows to
ROIs: its `label` and `file` are matched with the columns Label and Mask.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import features_of
from ..features.settings import COLUMNS
from ..features.table_files import DIAGNOSTICS

IMAGE, MASK, LABEL = "Image", "Mask", "Label"
SHOWN = 6  # values of a column that messages list


def is_pyradiomics_table(table: pd.DataFrame) -> bool:
    """Return whether the columns of a table are those that pyradiomics writes."""
    return {IMAGE, MASK} <= set(table.columns) or any(str(name).startswith(DIAGNOSTICS) for name in table.columns)


def short_names(values: pd.Series) -> dict[str, str]:
    """Return {path: path without the folders that all paths share}."""
    parts = {value: re.split(r"[/\\]", value) for value in values.unique()}
    shared = 0
    while len({tuple(part[: shared + 1]) for part in parts.values()}) == 1 and all(
        len(part) > shared + 1 for part in parts.values()
    ):
        shared += 1
    return {value: "/".join(part[shared:]) for value, part in parts.items()}


def to_native_layout(
    table: pd.DataFrame, settings: dict, rois: Sequence[dict], source: str
) -> tuple[pd.DataFrame, int]:
    """Return the table with columns image, roi and tissue_class, and the number of rows that belong to none of `rois`.

    Diagnostics are dropped, except those that state how features were extracted. All features are kept.

    Parameters
    ----------
    table : DataFrame
        As in the file; Label and the columns that `settings` names are text.
    settings : dict
        Section `features` of recording.yaml.
    rois : sequence of dict
        Section `rois` of recording.yaml; may be empty.

    Raises
    ------
    InputError
        For a missing column, rows without features, and ROIs that match no row or the same row.
    """
    image = _column(table, settings.get("image"), ("image", IMAGE), "features.image", source)
    others = [name for name in table.columns if not str(name).startswith(DIAGNOSTICS) or name in COLUMNS]
    _check_extracted(table, image, source)
    if rois:
        names, chosen = _matched(table, settings.get("roi"), rois, source)
    else:
        column = _column(table, settings.get("roi"), ("roi",), "features.roi", source, _advice(table))
        _column(table, None, ("tissue_class",), "", source, _advice(table))
        names, chosen = table[[column, "tissue_class"]], np.ones(len(table), dtype=bool)
    keys = pd.DataFrame({"image": table[image].astype(str).where(table[image].notna())})
    keys[["roi", "tissue_class"]] = names.to_numpy()
    taken = {"image", "roi", "tissue_class", IMAGE, MASK} - set(settings["conditions"])
    kept = table[[name for name in others if name not in taken]]
    return pd.concat([keys, kept], axis="columns")[chosen], int((~chosen).sum())


def _column(
    table: pd.DataFrame, stated: str | None, usual: Sequence[str], key: str, source: str, advice: str = ""
) -> str:
    wanted = usual if stated is None else (stated,)
    for name in wanted:
        if name in table:
            return name
    advice = advice or f"name the column in recording.yaml under {key}"
    raise InputError(f"{source}: has no column {' or '.join(wanted)}; {advice}")


def _advice(table: pd.DataFrame) -> str:
    column = LABEL if LABEL in table else MASK
    example = f"label: {table[LABEL].iloc[0]}" if LABEL in table else "file: liver.nii.gz"
    return (
        f"name the ROI of each {column} under rois in recording.yaml: - {{name: liver, tissue_class: liver, {example}}}"
    )


def _check_extracted(table: pd.DataFrame, image: str, source: str) -> None:
    if table.empty:
        raise InputError(f"{source}: has no rows below its header; use the table that pyradiomics wrote")
    features = features_of(table)
    if not features:
        raise InputError(f"{source}: has no columns of features; use the table that pyradiomics wrote")
    empty = table[features].isna().all(axis=1).to_numpy()
    if empty.any():
        row = int(empty.argmax())
        raise InputError(
            f"{source}: row {table.index[row]} (image {table[image].iloc[row]}) has no features: pyradiomics could not "
            "extract them and its log says why; remove the row"
        )


def _matched(
    table: pd.DataFrame, column: str | None, rois: Sequence[dict], source: str
) -> tuple[pd.DataFrame, np.ndarray]:
    """Return name and tissue class of every row, and whether the row belongs to an ROI."""
    found = np.full(len(table), -1)
    for number, roi in enumerate(rois):
        rows = _rows_of(table, column, roi, source)
        if not rows.any():
            raise InputError(f"{source}: no row matches {_describe_roi(roi)}; {_values(table, column)}")
        if (both := rows & (found >= 0)).any():
            row = int(both.argmax())
            raise InputError(
                f"{source}: row {table.index[row]} matches both {_describe_roi(rois[found[row]])} and "
                f"{_describe_roi(roi)}; distinguish them by label and file"
            )
        found[rows] = number
    names = pd.DataFrame([(roi["name"], roi["tissue_class"]) for roi in rois], columns=["roi", "tissue_class"])
    return names.reindex(found), found >= 0


def _rows_of(table: pd.DataFrame, column: str | None, roi: dict, source: str) -> np.ndarray:
    rows = np.ones(len(table), dtype=bool)
    if "file" in roi:
        advice = f"remove file of ROI {roi['name']} under rois, or add the column"
        masks = table[_column(table, None, (MASK,), "", source, advice)]
        paths = [PurePosixPath(str(value).replace("\\", "/")) for value in masks]
        try:
            rows &= np.array([path.match(roi["file"]) for path in paths], dtype=bool)
        except ValueError:
            raise InputError(f"{source}: rois: '{roi['file']}' is not a file name; use the name of a mask") from None
    if "label" in roi or "file" not in roi:
        values = table[_column(table, column, (LABEL,), "features.roi", source)].astype(str).str.strip()
        # Label 5 becomes 5.0 if a table with gaps in this column is written again.
        rows &= values.str.replace(r"^(\d+)\.0+$", r"\1", regex=True).eq(str(roi.get("label", roi["name"]))).to_numpy()
    return rows


def _describe_roi(roi: dict) -> str:
    keys = [f"{key} {roi[key]}" for key in ("label", "file") if key in roi]
    return f"ROI {roi['name']}" + (f" ({', '.join(keys)})" if keys else "")


def _values(table: pd.DataFrame, column: str | None) -> str:
    texts = []
    for name in dict.fromkeys((column or LABEL, MASK)):
        if name in table:
            values = [re.split(r"[/\\]", value)[-1] for value in table[name].astype(str).unique()]
            more = f" and {len(values) - SHOWN} more" if len(values) > SHOWN else ""
            texts.append(f"the column {name} contains {', '.join(values[:SHOWN])}{more}")
    return "; ".join(texts)
