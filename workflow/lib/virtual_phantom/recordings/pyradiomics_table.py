"""The table that pyradiomics writes of a batch, in the columns and names of a recording of features.

Its rows are cases: an image, a mask and perhaps a label. Which of them is which ROI stands under `rois` in
recording.yaml, whose `label` and `file` are matched with the columns Label and Mask.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import is_feature
from ..features.settings import COLUMNS
from ..features.table_files import DIAGNOSTICS

IMAGE, MASK, LABEL = "Image", "Mask", "Label"
SHOWN = 6  # values of a column in a message


def is_pyradiomics_table(table: pd.DataFrame) -> bool:
    """Whether a table is pyradiomics' own, by its columns."""
    return {IMAGE, MASK} <= set(table.columns) or any(str(name).startswith(DIAGNOSTICS) for name in table.columns)


def short_names(values: pd.Series) -> dict[str, str]:
    """Paths without the folders that all of them share.

    Parameters
    ----------
    values : Series of str
        What tells images apart: paths, or names that stay as they are.

    Returns
    -------
    dict of str to str
        {value: name}.
    """
    parts = {value: re.split(r"[/\\]", value) for value in values.unique()}
    shared = 0
    while len({tuple(one[: shared + 1]) for one in parts.values()}) == 1 and all(
        len(one) > shared + 1 for one in parts.values()
    ):
        shared += 1
    return {value: "/".join(one[shared:]) for value, one in parts.items()}


def renamed(table: pd.DataFrame, settings: dict, rois: Sequence[dict], source: str) -> tuple[pd.DataFrame, int]:
    """The table with the columns image, roi and tissue_class, and without what a recording does not keep.

    Of the diagnostics those stay that tell how features were extracted; features stay all.

    Parameters
    ----------
    table : DataFrame
        As in the file, Label and the columns that `settings` names as text.
    settings : dict
        The section `features` of recording.yaml.
    rois : sequence of dict
        Its section `rois`; empty if there is none.
    source : str
        What the message begins with.

    Returns
    -------
    left_out : int
        Rows that are of none of `rois`.

    Raises
    ------
    InputError
        For a column that is missing, rows without features, and ROIs that are not named, not there or not one.
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
    advice = advice or f"say in recording.yaml under {key} which column it is"
    raise InputError(f"{source}: lacks the column {' or '.join(wanted)}; {advice}")


def _advice(table: pd.DataFrame) -> str:
    column = LABEL if LABEL in table else MASK
    example = f"label: {table[LABEL].iloc[0]}" if LABEL in table else "file: liver.nii.gz"
    return (
        f"say under rois in recording.yaml which ROI each {column} is: "
        f"- {{name: liver, tissue_class: liver, {example}}}"
    )


def _check_extracted(table: pd.DataFrame, image: str, source: str) -> None:
    if table.empty:
        raise InputError(f"{source}: has no rows below the names of its columns; give the table that pyradiomics wrote")
    features = [name for name in table.columns if is_feature(name)]
    if not features:
        raise InputError(f"{source}: holds no feature of pyradiomics; give the table that it wrote")
    empty = table[features].isna().all(axis=1).to_numpy()
    if empty.any():
        row = int(empty.argmax())
        raise InputError(
            f"{source}: row {table.index[row]} (image {table[image].iloc[row]}) holds no features: pyradiomics could "
            "not extract them and its log says why; take the row out"
        )


def _matched(
    table: pd.DataFrame, column: str | None, rois: Sequence[dict], source: str
) -> tuple[pd.DataFrame, np.ndarray]:
    """Name and tissue class of every row, and whether it has one."""
    found = np.full(len(table), -1)
    for number, roi in enumerate(rois):
        own = _rows_of(table, column, roi, source)
        if not own.any():
            raise InputError(f"{source}: no row is of {_asked(roi)}; {_there(table, column)}")
        if (both := own & (found >= 0)).any():
            row = int(both.argmax())
            raise InputError(
                f"{source}: row {table.index[row]} is of {_asked(rois[found[row]])} and of {_asked(roi)}; tell them "
                "apart by label and file"
            )
        found[own] = number
    names = pd.DataFrame([(one["name"], one["tissue_class"]) for one in rois], columns=["roi", "tissue_class"])
    return names.reindex(found), found >= 0


def _rows_of(table: pd.DataFrame, column: str | None, roi: dict, source: str) -> np.ndarray:
    own = np.ones(len(table), dtype=bool)
    if "file" in roi:
        masks = table[_column(table, None, (MASK,), "", source, f"rois cannot name files then ({roi['name']})")]
        paths = [PurePosixPath(str(value).replace("\\", "/")) for value in masks]
        try:
            own &= np.array([path.match(roi["file"]) for path in paths], dtype=bool)
        except ValueError:
            raise InputError(f"{source}: rois: '{roi['file']}' is no name of a mask; give a file's name") from None
    if "label" in roi or "file" not in roi:
        values = table[_column(table, column, (LABEL,), "features.roi", source)].astype(str).str.strip()
        # Label 5 becomes 5.0 where a table was written again with gaps in that column.
        own &= values.str.replace(r"^(\d+)\.0+$", r"\1", regex=True).eq(str(roi.get("label", roi["name"]))).to_numpy()
    return own


def _asked(roi: dict) -> str:
    how = [f"{key} {roi[key]}" for key in ("label", "file") if key in roi]
    return f"ROI {roi['name']}" + (f" ({', '.join(how)})" if how else "")


def _there(table: pd.DataFrame, column: str | None) -> str:
    texts = []
    for name in dict.fromkeys((column or LABEL, MASK)):
        if name in table:
            values = [re.split(r"[/\\]", value)[-1] for value in table[name].astype(str).unique()]
            more = f" and {len(values) - SHOWN} more" if len(values) > SHOWN else ""
            texts.append(f"the column {name} holds {', '.join(values[:SHOWN])}{more}")
    return "; ".join(texts)
