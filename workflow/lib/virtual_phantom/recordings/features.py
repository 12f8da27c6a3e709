"""Recordings of features: CSV tables with one row per image and ROI, in our layout or as pyradiomics writes them."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ..base.errors import InputError
from ..base.words import counted
from ..features import consistency
from ..features.names import FEATURES, MEAN, VARIANCE, features_of, is_feature
from ..features.settings import Extraction, differences, distinct, of_table
from ..features.table_files import read_table
from ..features.tables import finite_values
from . import pyradiomics_table
from .document import Document
from .provenance import checksums
from .recording import Provenance, Recording

KEYS = ("image", "roi", "tissue_class")
# Keys of recording.yaml that only a table of somebody else's layout needs.
LAYOUT = ("image", "roi")
STORED_ABOVE = 500.0  # mean of a soft-tissue ROI: under this in HU, over it in stored values
# Difference of the means of one ROI in stored values and in HU: 1000 or 1024, give or take 100 HU of contrast medium.
STORED_APART = (900.0, 1124.0)
ENOUGH_FEATURES = 10  # features of two noisy images that do not agree in every digit by chance


@dataclass(frozen=True)
class FeaturesRecording(Recording):
    """Features measured on repeated images.

    Attributes
    ----------
    repeats, held_out : DataFrame
        Tables with the columns image, roi, tissue_class, the conditions, whatever else the files hold, and `features`;
        values as in the files.
    features : tuple of str
        Those of the study that the tables have, in its order.
    extractions : tuple of Extraction
        How they were extracted, each way once, as the tables tell; empty where they do not.
    """

    repeats: pd.DataFrame
    held_out: pd.DataFrame
    features: tuple[str, ...]
    extractions: tuple[Extraction, ...] = ()

    @property
    def conditions(self) -> tuple[str, ...]:
        """Columns that tell the conditions of images apart."""
        return tuple(self.document.content["features"]["conditions"])

    @property
    def stored_offset_hu(self) -> float:
        """What was added to HU before the features were extracted."""
        return float(self.document.content["features"]["stored_offset_hu"])

    @property
    def dimensions(self) -> int:
        """2 if features were extracted from single slices, else 3."""
        return int(self.document.content["features"]["dimensions"])

    def images_per_condition(self) -> pd.Series:
        """Number of images of each condition, held-out ones not counted."""
        if not self.conditions:
            return pd.Series([self.repeats["image"].nunique()], index=["all"])
        return self.repeats.groupby(list(self.conditions))["image"].nunique()


def load_features(document: Document, study: tuple[str, ...] = FEATURES) -> FeaturesRecording:
    """Read all tables.

    Parameters
    ----------
    study : tuple of str, optional
        The study's features. A table of pyradiomics may have others, which are left out.

    Raises
    ------
    InputError
        If any is not what recording.yaml says.
    """
    settings = document.content["features"]
    if unknown := [name for name in settings["absent"] if name not in FEATURES]:
        raise InputError(f"{document.path}: features.absent: {_unknown(unknown[0])}")
    tables, features, notes = _tables(document, study)
    places: dict[str, Path] = {}
    extractions: list[Extraction | None] = []
    for path, table in tables.items():
        for image in table["image"].unique():
            if image in places:
                raise InputError(f"{path}: image {image} is in {places[image].name} too; name every image differently")
            places[image] = path
        _check_offset(path, table, settings["stored_offset_hu"])
        found = of_table(table, str(path), table.index)
        _check_extraction(path, table, found, settings)
        extractions += found
    _check_one_unit(tables)
    _check_copies(tables, settings["conditions"])
    repeats = pd.concat([tables[path] for path in document.repeats], ignore_index=True)
    held_out = [tables[path] for path in document.held_out]
    held_out = pd.concat(held_out, ignore_index=True) if held_out else repeats.iloc[:0]
    if settings["stored_offset_hu"]:
        notes.append(
            f"features are of HU + {settings['stored_offset_hu']} (features.stored.to_hu corrects first-order ones)"
        )
    incomplete = repeats.groupby("image")["roi"].nunique() < repeats["roi"].nunique()
    if incomplete.any():
        notes.append(f"some of the ROIs are missing in {int(incomplete.sum())} of {incomplete.size} images")
    provenance = Provenance(document.content["origin"], checksums(document))
    known = tuple(distinct(extractions))
    return FeaturesRecording(document, provenance, None, tuple(notes), repeats, held_out, features, known)


def _tables(document: Document, study: tuple[str, ...]) -> tuple[dict[Path, pd.DataFrame], tuple[str, ...], list[str]]:
    """All tables in our layout, the features that they have, and what is to be said of them.

    Our own layout has the 86 but for those said to be absent, and no other feature but `study`. A table of pyradiomics
    has what it has: features that are not of the study are left out, those that are missing are named.

    Raises
    ------
    InputError
        For what `read` and `pyradiomics_table.renamed` refuse, and if no feature is in all tables.
    """
    settings, rois = document.content["features"], document.content.get("rois", [])
    tables = {path: _csv(path, settings) for path in (*document.repeats, *document.held_out)}
    conditions, source = settings["conditions"], str(document.path)
    foreign = any(key in settings for key in LAYOUT) or any(
        map(pyradiomics_table.is_pyradiomics_table, tables.values())
    )
    absent = set(settings["absent"])
    if not rois and not foreign:
        more = [one for one in study if one not in FEATURES and all(one in table for table in tables.values())]
        wanted = tuple(one for one in (*FEATURES, *more) if one not in absent)
        return {path: _checked(path, table, wanted, conditions) for path, table in tables.items()}, wanted, []
    left_out, notes = 0, []
    for path, table in tables.items():
        tables[path], rows = pyradiomics_table.renamed(table, settings, rois, str(path))
        left_out += rows
    names = pyradiomics_table.short_names(pd.concat([table["image"].dropna() for table in tables.values()]))
    wanted = tuple(one for one in study if one not in absent)
    features = tuple(one for one in wanted if all(one in table for table in tables.values()))
    if not features:
        raise InputError(f"{source}: its tables have none of the {len(study)} features of the study in common")
    others = {one for table in tables.values() for one in table if is_feature(one)} - set(features)
    if left_out:
        notes.append(f"left out: {counted(left_out, 'row')} of ROIs that recording.yaml does not name")
    if others:
        which = "shape, filters and what else the study has not"
        notes.append(f"left out: {counted(len(others), 'other feature')} ({which})")
    if missing := [one for one in study if one not in features]:
        notes.append(f"missing: {len(missing)} of the {len(study)} features ({', '.join(missing)})")
    ours = {
        path: table.assign(image=table["image"].map(names)).drop(columns=[one for one in table if one in others])
        for path, table in tables.items()
    }
    return {path: _checked(path, table, features, conditions) for path, table in ours.items()}, features, notes


def read(path: Path, features: tuple[str, ...], conditions: list[str]) -> pd.DataFrame:
    """Read one table.

    Parameters
    ----------
    path : Path
        The CSV file.
    conditions : list of str
        Columns.

    Returns
    -------
    DataFrame
        Keys come first, then its other columns, then `features`.

    Raises
    ------
    InputError
        If it is not CSV or empty; if the features of a row cannot belong to one region; if a column of KEYS, a
        condition or a feature is missing, empty somewhere or there twice; if a column is named as a feature but is
        none of ours; if two rows are of one ROI of one image, or an image has two conditions or an ROI two tissue
        classes; if a feature is not a finite number.
    """
    return _checked(path, _csv(path, {"conditions": conditions}), features, conditions).reset_index(drop=True)


def _csv(path: Path, settings: dict) -> pd.DataFrame:
    """A table with the numbers of its rows as index and features that can belong to one region each."""
    table = read_table(path, [settings[key] for key in LAYOUT if key in settings], settings.get("conditions", ()))
    consistency.check(table, str(path))
    return table


def _checked(path: Path, table: pd.DataFrame, features: tuple[str, ...], conditions: list[str]) -> pd.DataFrame:
    needed = (*KEYS, *conditions, *features)
    for name in table.columns:
        if name not in needed and is_feature(name):
            raise InputError(f"{path}: {_unknown(name)}; correct it or take the column out")
    if missing := [name for name in needed if name not in table]:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        advice = "; if they were not extracted, list them under features.absent" if missing[0] in FEATURES else ""
        raise InputError(f"{path}: lacks the column {missing[0]}{more}{advice}")
    if table.empty:
        raise InputError(f"{path}: holds no rows")
    for name in (*KEYS, *conditions):
        if table[name].isna().any():
            row = table.index[int(table[name].isna().to_numpy().argmax())]
            raise InputError(f"{path}: {name} is empty in row {row}")
    _check_keys(path, table, conditions)
    finite_values(table, features, str(path))
    others = [name for name in table.columns if name not in needed]
    return table[[*KEYS, *conditions, *others, *features]]


def _unknown(name: str) -> str:
    close = difflib.get_close_matches(name, FEATURES, 1)
    hint = f"did you mean {close[0]}?" if close else "none of the 86 features of the study"
    return f"unknown feature {name}, {hint}"


def _check_keys(path: Path, table: pd.DataFrame, conditions: list[str]) -> None:
    if (double := table.duplicated(["image", "roi"])).any():
        row = table[double].iloc[0]
        raise InputError(f"{path}: two rows for ROI {row['roi']} of image {row['image']}")
    for owner, names in (("image", conditions), ("roi", ["tissue_class"])):
        for name in names:
            several = table.groupby(owner)[name].nunique() > 1
            if several.any():
                raise InputError(f"{path}: {owner} {several.idxmax()} has more than one {name}")


def _check_extraction(
    path: Path, table: pd.DataFrame, extractions: Sequence[Extraction | None], settings: dict
) -> None:
    """Images that count as repeats were extracted alike, and in as many dimensions as recording.yaml says."""
    for one in distinct(extractions):
        if one.effective()["force2D"] and settings["dimensions"] == 3:
            raise InputError(
                f"{path}: was extracted with force2D, slice by slice, but recording.yaml says 3 dimensions; set "
                "features.dimensions: 2"
            )
    conditions = settings["conditions"]
    groups = table.groupby(conditions).indices.values() if conditions else [range(len(table))]
    for rows in groups:
        first, *more = distinct([extractions[row] for row in rows]) or [None]
        for other in more:
            if found := differences(first, other):
                raise InputError(
                    f"{path}: repeats were extracted with {found[0].setting} {found[0].study} and {found[0].table}; "
                    "give a column that tells them apart under features.conditions, or a recording each"
                )


def _check_offset(path: Path, table: pd.DataFrame, stored_offset_hu: float) -> None:
    if MEAN not in table:
        return
    typical = float(table[MEAN].median())
    if (typical > STORED_ABOVE) == (stored_offset_hu > 0):
        return
    advice = "set features.stored_offset_hu: 1024" if typical > STORED_ABOVE else "set features.stored_offset_hu: 0"
    raise InputError(
        f"{path}: the mean of an ROI is {typical:.0f}, but recording.yaml says that values are HU + "
        f"{stored_offset_hu}; {advice}, or correct the table"
    )


def _check_one_unit(tables: Mapping[Path, pd.DataFrame]) -> None:
    """Refuse images in HU beside images in stored values: the means of their ROIs lie some 1024 apart."""
    parts = [table[["image", "roi", MEAN]].assign(file=str(path)) for path, table in tables.items() if MEAN in table]
    if not parts:
        return
    rows = pd.concat(parts)
    above = rows[MEAN] - rows.groupby("roi")[MEAN].transform("min")
    images = above.groupby([rows["file"], rows["image"]], sort=False).median()
    stored = images.between(*STORED_APART)
    if stored.any() and not images.between(STORED_APART[0] / 3, STORED_APART[0], inclusive="left").any():
        (file, image), height = stored.idxmax(), images[stored].iloc[0]
        raise InputError(
            f"{file}: the means of the ROIs of image {image} lie {height:.0f} above those of other images; bring all "
            "rows to HU, or all to HU + 1024"
        )


def _check_copies(tables: Mapping[Path, pd.DataFrame], conditions: Sequence[str]) -> None:
    """Refuse repeats whose features agree in every digit: one image that is there twice under two names."""
    parts = [table.assign(file=str(path), row=table.index) for path, table in tables.items()]
    rows = pd.concat(parts, ignore_index=True)
    features = features_of(rows)
    if len(features) < ENOUGH_FEATURES or VARIANCE not in features:
        return
    noisy = rows[rows[VARIANCE] > 0]
    copies = noisy.duplicated(["roi", *conditions, *features])
    if copies.any():
        second = noisy[copies].iloc[0]
        same = (noisy[["roi", *conditions, *features]] == second[["roi", *conditions, *features]]).all(axis="columns")
        first = noisy[same].iloc[0]
        raise InputError(
            f"{second['file']}: row {second['row']} (image {second['image']}) repeats all {len(features)} features of "
            f"row {first['row']} (image {first['image']}) for ROI {second['roi']}; give every image once"
        )
