"""Tables of features: one row per image and ROI, what was scanned first, then the features."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..io.files import read_csv
from .names import FEATURES, features_of
from .settings import OWN

PROVENANCE = ("settings_hash", "pyradiomics_version", "numpy_version", "simpleitk_version")
ACQUISITION = ("protocol", "algorithm", "projections", "noise", "noise_level", "seed")
METADATA = (*ACQUISITION, "roi", "tissue_class", "n_voxels", "grey_levels", *PROVENANCE)


def complete(extracted: pd.DataFrame, tissue_classes: dict[str, str], acquisition: dict) -> pd.DataFrame:
    """Rows of a table with the acquisition and each ROI's tissue class beside them.

    Parameters
    ----------
    extracted : DataFrame
        From `extraction.extract`.
    tissue_classes : dict of str to str
        By ROI.
    acquisition : dict
        Keys of ACQUISITION.

    Returns
    -------
    DataFrame
        Columns METADATA and the features.
    """
    features = features_of(extracted)
    table = extracted.assign(**acquisition, tissue_class=extracted["roi"].map(tissue_classes))
    return table[[*METADATA, *features]]


def read(path: str | Path) -> pd.DataFrame:
    """Read a table of features; numbers come back bit for bit.

    Raises
    ------
    InputError
        If it is missing or lacks a column.
    """
    table = read_csv(path)
    # What a parameter file asked for stands in the table alone; its extraction refuses to leave any out.
    own = "settings_hash" in table and table["settings_hash"].astype(str).str.startswith(OWN).all()
    features = (features_of(table) or FEATURES[:1]) if own else FEATURES
    if missing := [column for column in (*METADATA, *features) if column not in table]:
        raise InputError(f"{path}: lacks {len(missing)} column(s) of a feature table, the first {missing[0]}")
    return table


def merge(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """All tables in one, whatever their order.

    Parameters
    ----------
    tables : iterable of DataFrame
        From `complete`.

    Returns
    -------
    DataFrame
        Sorted by protocol, noise label, seed and the order in which ROIs stand in the tables.

    Raises
    ------
    InputError
        If two rows describe the same ROI of the same image, an ROI is not in every table, or rows were made with
        different settings or versions.
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
    rank = merged["roi"].map({roi: place for place, roi in enumerate(roi_order)})
    return (
        merged.assign(_rank=rank)
        .sort_values(["protocol", "noise", "seed", "_rank"], ignore_index=True)
        .drop(columns="_rank")
    )


def _file(row: pd.Series) -> str:
    """Where a row comes from, under results_dir/features."""
    return f"{row['protocol']}/{row['noise']}/seed{row['seed']:02d}.csv"


def select(table: pd.DataFrame, *, protocols: Sequence[str], noise: Sequence[str], seeds: int) -> pd.DataFrame:
    """Rows of these protocols and noise labels, and of the first `seeds` seeds of each.

    Raises
    ------
    InputError
        Naming the protocol and noise label that has fewer seeds.
    """
    chosen = table[table["protocol"].isin(protocols) & table["noise"].isin(noise)]
    order = chosen.groupby(["protocol", "noise"])["seed"].rank(method="dense")
    chosen = chosen[order <= seeds]
    have = chosen.groupby(["protocol", "noise"])["seed"].nunique()
    for key in ((p, n) for p in protocols for n in noise):
        if have.get(key, 0) < seeds:
            raise InputError(
                f"features: {have.get(key, 0)} seeds for protocol {key[0]}, noise {key[1]}; {seeds} are asked for"
            )
    return chosen.reset_index(drop=True)


def grouped(table: pd.DataFrame, groups: Mapping[str, int], *, noise: str, seeds: int) -> pd.DataFrame:
    """Rows of the protocols that have a group number, at one noise label.

    Parameters
    ----------
    groups : mapping of str to int
        Number of each protocol's group.
    noise : str
        Label of the noise level.
    seeds : int
        How many of each protocol.

    Returns
    -------
    DataFrame
        With the number as column group.

    Raises
    ------
    InputError
        As `select`.
    """
    chosen = select(table, protocols=list(groups), noise=[noise], seeds=seeds)
    return chosen.assign(group=chosen["protocol"].map(groups))


def refuse_doubles(table: pd.DataFrame, source: str) -> None:
    """Refuse a table in which a group has a seed of an ROI twice: two protocols of one group are no repeats.

    Parameters
    ----------
    table : DataFrame
        With columns roi, group and seed.
    source : str
        What the message begins with.

    Raises
    ------
    InputError
        Naming the first such row.
    """
    keys = ["roi", "group", "seed"]
    double = table.duplicated(keys).to_numpy()
    if double.any():
        roi, group, seed = table.loc[double, keys].iloc[0]
        raise InputError(
            f"{source}: two rows for ROI {roi}, group {group}, seed {seed}; give every protocol a group of its own, or "
            "make the table again"
        )


def finite_values(table: pd.DataFrame, features: Sequence[str], source: str) -> np.ndarray:
    """The features of a table as numbers.

    Parameters
    ----------
    features : sequence of str
        Which columns.
    source : str
        What the message begins with.

    Returns
    -------
    ndarray of float64, shape (rows, features)

    Raises
    ------
    InputError
        Naming the first value that is text or not finite.
    """
    values = table[list(features)].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        value = table[features[column]].iloc[row]
        known = [key for key in (*ACQUISITION, "group", "scan", "roi") if key in table]
        where = ", ".join(f"{key} {table[key].iloc[row]}" for key in known)
        raise InputError(f"{source}: {features[column]} is {value} for {where}; is that ROI large enough?")
    return values
