"""Feature tables: one row per image and ROI, with columns METADATA, then the features."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..io.files import read_csv
from .names import FEATURES, features_of
from .settings import CUSTOM_PREFIX

PROVENANCE = ("settings_hash", "pyradiomics_version", "numpy_version", "simpleitk_version")
ACQUISITION = ("protocol", "algorithm", "projections", "noise", "noise_level", "seed")
METADATA = (*ACQUISITION, "roi", "tissue_class", "n_voxels", "grey_levels", *PROVENANCE)


def add_acquisition(extracted: pd.DataFrame, tissue_classes: dict[str, str], acquisition: dict) -> pd.DataFrame:
    """Add the columns of `acquisition` (keys ACQUISITION) and the tissue class of each ROI to an extracted table."""
    features = features_of(extracted)
    table = extracted.assign(**acquisition, tissue_class=extracted["roi"].map(tissue_classes))
    return table[[*METADATA, *features]]


def read_features(path: str | Path) -> pd.DataFrame:
    """Read a feature table; numbers are restored bit for bit.

    Raises
    ------
    InputError
        If the file is missing or lacks a column.
    """
    table = read_csv(path)
    # Only the table records the features of a parameter file; the extraction ensures that none is missing.
    custom = "settings_hash" in table and table["settings_hash"].astype(str).str.startswith(CUSTOM_PREFIX).all()
    features = (features_of(table) or FEATURES[:1]) if custom else FEATURES
    if missing := [column for column in (*METADATA, *features) if column not in table]:
        raise InputError(f"{path}: lacks {len(missing)} column(s) of a feature table, the first {missing[0]}")
    return table


def merge_tables(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Merge tables from `add_acquisition`, sorted by protocol, noise label, seed and order of ROIs.

    Raises
    ------
    InputError
        If two rows are for the same ROI of the same image, an ROI is not in every table, or settings or versions
        differ.
    """
    tables = list(tables)
    roi_order = dict.fromkeys(tables[0]["roi"])
    for table in tables:
        if odd := set(roi_order) ^ set(table["roi"]):
            raise InputError(
                f"feature tables: ROI {sorted(odd)[0]} is not in every image; extract with one set of ROIs"
            )
    merged = pd.concat(tables, ignore_index=True)
    for column in PROVENANCE:
        if (odd := merged[column] != merged[column].iloc[0]).any():
            here, there = (f"{row[column]} of {_file(row)}" for _, row in merged.loc[[0, odd.idxmax()]].iterrows())
            raise InputError(
                f"feature tables: made with different {column}, {here} and {there}; delete the folder features under "
                "results_dir and run again"
            )
    keys = ["protocol", "noise", "seed", "roi"]
    if (double := merged.duplicated(keys)).any():
        row = merged.loc[double, keys].iloc[0]
        raise InputError("feature tables: two rows for " + ", ".join(f"{key} {row[key]}" for key in keys))
    rank = merged["roi"].map({roi: position for position, roi in enumerate(roi_order)})
    return (
        merged.assign(_rank=rank)
        .sort_values(["protocol", "noise", "seed", "_rank"], ignore_index=True)
        .drop(columns="_rank")
    )


def _file(row: pd.Series) -> str:
    """Return the file of a row, relative to results_dir/features."""
    return f"{row['protocol']}/{row['noise']}/seed{row['seed']:02d}.csv"


def select(table: pd.DataFrame, *, protocols: Sequence[str], noise: Sequence[str], seeds: int) -> pd.DataFrame:
    """Select rows by protocol and noise label, with the first `seeds` seeds of each.

    Raises
    ------
    InputError
        If a protocol and noise label has fewer seeds.
    """
    chosen = table[table["protocol"].isin(protocols) & table["noise"].isin(noise)]
    order = chosen.groupby(["protocol", "noise"])["seed"].rank(method="dense")
    chosen = chosen[order <= seeds]
    have = chosen.groupby(["protocol", "noise"])["seed"].nunique()
    for key in ((p, n) for p in protocols for n in noise):
        if have.get(key, 0) < seeds:
            raise InputError(
                f"features: {have.get(key, 0)} seeds for protocol {key[0]}, noise {key[1]}; {seeds} are needed"
            )
    return chosen.reset_index(drop=True)


def read_groups(path: str | Path, groups: Mapping[str, int], *, noise: Mapping[str, str], seeds: int) -> pd.DataFrame:
    """Read a feature table and `select` rows, with the number of each protocol in the column group.

    Parameters
    ----------
    groups : mapping of str to int
        {protocol: number}.
    noise : mapping of str to str
        {protocol: noise level}.

    Raises
    ------
    InputError
        As in `read_features` and `select`.
    """
    table = read_features(path)
    chosen = [select(table, protocols=[name], noise=[noise[name]], seeds=seeds) for name in sorted(groups)]
    found = pd.concat(chosen, ignore_index=True)
    return found.assign(group=found["protocol"].map(dict(groups)))


def require_unique_rows(table: pd.DataFrame, source: str) -> None:
    """Check that no two rows have the same roi, group and seed: two protocols of one group are not repeats.

    Raises
    ------
    InputError
        Starting with `source` and naming the first repeated row.
    """
    keys = ["roi", "group", "seed"]
    double = table.duplicated(keys).to_numpy()
    if double.any():
        roi, group, seed = table.loc[double, keys].iloc[0]
        raise InputError(
            f"{source}: two rows for ROI {roi}, group {group}, seed {seed}; give each protocol a different group, "
            "or recreate the table"
        )


def finite_values(table: pd.DataFrame, features: Sequence[str], source: str) -> np.ndarray:
    """Return features of a table as float64, shape (rows, features).

    Raises
    ------
    InputError
        Starting with `source` and naming the first value that is text or not finite.
    """
    values = table[list(features)].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        value = table[features[column]].iloc[row]
        known = [key for key in (*ACQUISITION, "group", "scan", "roi") if key in table]
        where = ", ".join(f"{key} {table[key].iloc[row]}" for key in known)
        raise InputError(f"{source}: {features[column]} is {value} for {where}; is that ROI large enough?")
    return values
