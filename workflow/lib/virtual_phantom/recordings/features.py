"""Recordings of features: CSV tables with one row per image and ROI, in the native layout or written by pyradiomics."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from ..base.errors import InputError
from ..base.names import counted
from ..features import consistency
from ..features.names import FEATURES, MEAN, VARIANCE, features_of, is_feature
from ..features.settings import Extraction, differences, distinct_extractions, read_extractions
from ..features.table_files import read_table
from ..features.tables import finite_values
from .document import Document
from .provenance import checksums
from .pyradiomics_table import is_pyradiomics_table, short_names, to_native_layout
from .recording import Provenance, Recording

KEYS = ("image", "roi", "tissue_class")
# Keys of recording.yaml that only tables in another layout need.
LAYOUT = ("image", "roi")
STORED_ABOVE = 500.0  # means of soft-tissue ROIs are lower in HU and higher in stored values
# Difference of an ROI's mean between stored values and HU: 1000 or 1024, with 100 HU for contrast medium.
STORED_DIFFERENCE = (900.0, 1124.0)
ENOUGH_FEATURES = 10  # so many features of two noisy images do not agree in every digit by chance


@dataclass(frozen=True)
class FeaturesRecording(Recording):
    """Features measured on repeated images.

    Attributes
    ----------
    repeats, held_out : DataFrame
        Columns image, roi, tissue_class, the conditions, further columns of the files, and `features`; values as in the
        files.
    features : tuple of str
        Features of the study that all tables have, in the study's order.
    extractions : tuple of Extraction
        Distinct extraction settings according to the tables; empty if these do not state them.
    """

    repeats: pd.DataFrame
    held_out: pd.DataFrame
    features: tuple[str, ...]
    extractions: tuple[Extraction, ...] = ()

    @property
    def conditions(self) -> tuple[str, ...]:
        """Columns that distinguish the conditions of images."""
        return tuple(self.document.content["features"]["conditions"])

    @property
    def stored_offset_hu(self) -> float:
        """Offset added to HU before the features were extracted."""
        return float(self.document.content["features"]["stored_offset_hu"])

    @property
    def dimensions(self) -> int:
        """2 if features were extracted from single slices, otherwise 3."""
        return int(self.document.content["features"]["dimensions"])

    def images_per_condition(self) -> pd.Series:
        """Return the number of images per condition, without held-out images."""
        if not self.conditions:
            return pd.Series([self.repeats["image"].nunique()], index=["all"])
        return self.repeats.groupby(list(self.conditions))["image"].nunique()


def load_features(document: Document, study: tuple[str, ...] = FEATURES) -> FeaturesRecording:
    """Read and check all tables.

    Parameters
    ----------
    study : tuple of str, optional
        Features of the study. Other features in tables of pyradiomics are ignored.

    Raises
    ------
    InputError
        If a table cannot be read or does not match recording.yaml. Reasons are missing or unknown columns, empty or
        repeated keys, implausible or inconsistent values, mixed units, and repeated images.
    """
    settings = document.content["features"]
    if unknown := [name for name in settings["absent"] if name not in FEATURES]:
        raise InputError(f"{document.path}: features.absent: {_unknown(unknown[0])}")
    tables, features, notes = _tables(document, study)
    files: dict[str, Path] = {}
    extractions: list[Extraction | None] = []
    for path, table in tables.items():
        for image in table["image"].unique():
            if image in files:
                raise InputError(f"{path}: image {image} is also in {files[image].name}; give every image its own name")
            files[image] = path
        _check_offset(path, table, settings["stored_offset_hu"])
        found = read_extractions(table, str(path), table.index)
        _check_extraction(path, table, found, settings)
        extractions += found
    _check_one_unit(tables)
    _check_copies(tables, settings["conditions"])
    repeats = pd.concat([tables[path] for path in document.repeats], ignore_index=True)
    held_out = [tables[path] for path in document.held_out]
    held_out = pd.concat(held_out, ignore_index=True) if held_out else repeats.iloc[:0]
    if settings["stored_offset_hu"]:
        notes.append(
            f"features were extracted from HU + {settings['stored_offset_hu']} (features.hu_offset.convert_to_hu "
            "corrects first-order features)"
        )
    incomplete = repeats.groupby("image")["roi"].nunique() < repeats["roi"].nunique()
    if incomplete.any():
        notes.append(f"ROIs are missing in {int(incomplete.sum())} of {incomplete.size} images")
    provenance = Provenance(document.content["origin"], checksums(document))
    known = tuple(distinct_extractions(extractions))
    return FeaturesRecording(document, provenance, None, tuple(notes), repeats, held_out, features, known)


def _tables(document: Document, study: tuple[str, ...]) -> tuple[dict[Path, pd.DataFrame], tuple[str, ...], list[str]]:
    """Return all tables in the native layout, their common features, and notes.

    Tables in the native layout must have the 86 features except `absent` features. Their other features must be in
    `study`. Tables of pyradiomics may have any features. Notes report additional and missing features.

    Raises
    ------
    InputError
        As in load_features.
    """
    settings, rois = document.content["features"], document.content.get("rois", [])
    tables = {path: _csv(path, settings) for path in (*document.repeats, *document.held_out)}
    conditions, source = settings["conditions"], str(document.path)
    foreign = any(key in settings for key in LAYOUT) or any(map(is_pyradiomics_table, tables.values()))
    absent = set(settings["absent"])
    if not rois and not foreign:
        more = [name for name in study if name not in FEATURES and all(name in table for table in tables.values())]
        wanted = tuple(name for name in (*FEATURES, *more) if name not in absent)
        return {path: _checked(path, table, wanted, conditions) for path, table in tables.items()}, wanted, []
    skipped, notes = 0, []
    for path, table in tables.items():
        tables[path], rows = to_native_layout(table, settings, rois, str(path))
        skipped += rows
    names = short_names(pd.concat([table["image"].dropna() for table in tables.values()]))
    features = tuple(name for name in study if name not in absent and all(name in table for table in tables.values()))
    if not features:
        raise InputError(
            f"{source}: repeats have none of the {len(study)} features of the study in common; extract the same "
            "features for all tables"
        )
    others = {name for table in tables.values() for name in table if is_feature(name)} - set(features)
    if skipped:
        notes.append(f"ignored: {counted(skipped, 'row')} of ROIs that recording.yaml does not name")
    if others:
        notes.append(f"ignored: {counted(len(others), 'feature')} that the study does not have (shape, filters, ...)")
    if missing := [name for name in study if name not in features]:
        notes.append(f"missing: {len(missing)} of the {len(study)} features ({', '.join(missing)})")
    native = {
        path: table.assign(image=table["image"].map(names)).drop(columns=[name for name in table if name in others])
        for path, table in tables.items()
    }
    return {path: _checked(path, table, features, conditions) for path, table in native.items()}, features, notes


def _csv(path: Path, settings: dict) -> pd.DataFrame:
    """Read a table; its index is the row number in the file. Features must be consistent with one region each."""
    table = read_table(path, [settings[key] for key in LAYOUT if key in settings], settings.get("conditions", ()))
    consistency.check(table, str(path))
    return table


def _checked(path: Path, table: pd.DataFrame, features: tuple[str, ...], conditions: list[str]) -> pd.DataFrame:
    needed = (*KEYS, *conditions, *features)
    for name in table.columns:
        if name not in needed and is_feature(name):
            raise InputError(f"{path}: {_unknown(name)}; correct or remove the column")
    if missing := [name for name in needed if name not in table]:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        absent = "; if it was not extracted, list it under features.absent" if missing[0] in FEATURES else ""
        raise InputError(f"{path}: has no column {missing[0]}{more}; add it{absent}")
    if table.empty:
        raise InputError(f"{path}: has no rows; write one row per image and ROI")
    for name in (*KEYS, *conditions):
        if table[name].isna().any():
            row = table.index[int(table[name].isna().to_numpy().argmax())]
            raise InputError(f"{path}: {name} is empty in row {row}; fill it in")
    _check_keys(path, table, conditions)
    finite_values(table, features, str(path))
    others = [name for name in table.columns if name not in needed]
    return table[[*KEYS, *conditions, *others, *features]]


def _unknown(name: str) -> str:
    close = difflib.get_close_matches(name, FEATURES, 1)
    hint = f"did you mean {close[0]}?" if close else "which is not one of the 86 features of the study"
    return f"unknown feature {name}, {hint}"


def _check_keys(path: Path, table: pd.DataFrame, conditions: list[str]) -> None:
    if (double := table.duplicated(["image", "roi"])).any():
        row = table[double].iloc[0]
        raise InputError(f"{path}: two rows for ROI {row['roi']} of image {row['image']}; keep one of them")
    for owner, names in (("image", conditions), ("roi", ["tissue_class"])):
        for name in names:
            several = table.groupby(owner)[name].nunique() > 1
            if several.any():
                raise InputError(f"{path}: {owner} {several.idxmax()} has more than one {name}; correct that column")


def _check_extraction(
    path: Path, table: pd.DataFrame, extractions: Sequence[Extraction | None], settings: dict
) -> None:
    """Check that repeats were extracted with equal settings, and in as many dimensions as recording.yaml says."""
    for extraction in distinct_extractions(extractions):
        if extraction.effective()["force2D"] and settings["dimensions"] == 3:
            raise InputError(
                f"{path}: was extracted slice by slice (force2D), but recording.yaml says features.dimensions 3; set "
                "features.dimensions: 2"
            )
    conditions = settings["conditions"]
    groups = table.groupby(conditions).indices.values() if conditions else [range(len(table))]
    for rows in groups:
        first, *more = distinct_extractions([extractions[row] for row in rows]) or [None]
        for other in more:
            if found := differences(first, other):
                raise InputError(
                    f"{path}: repeats were extracted with {found[0].setting} {found[0].study} and {found[0].table}; "
                    "list a column that distinguishes them under features.conditions, or make separate recordings"
                )


def _check_offset(path: Path, table: pd.DataFrame, stored_offset_hu: float) -> None:
    if MEAN not in table:
        return
    typical = float(table[MEAN].median())
    if (typical > STORED_ABOVE) == (stored_offset_hu > 0):
        return
    advice = "set features.stored_offset_hu: 1024" if typical > STORED_ABOVE else "set features.stored_offset_hu: 0"
    raise InputError(
        f"{path}: the median mean of the ROIs is {typical:.0f}, but recording.yaml says that values are HU + "
        f"{stored_offset_hu}; {advice}, or correct the table"
    )


def _check_one_unit(tables: Mapping[Path, pd.DataFrame]) -> None:
    """Refuse a mixture of images in HU and in stored values: the means of their ROIs differ by about 1024."""
    parts = [table[["image", "roi", MEAN]].assign(file=str(path)) for path, table in tables.items() if MEAN in table]
    if not parts:
        return
    rows = pd.concat(parts)
    above = rows[MEAN] - rows.groupby("roi")[MEAN].transform("min")
    images = above.groupby([rows["file"], rows["image"]], sort=False).median()
    stored = images.between(*STORED_DIFFERENCE)
    if stored.any() and not images.between(STORED_DIFFERENCE[0] / 3, STORED_DIFFERENCE[0], inclusive="left").any():
        (file, image), height = stored.idxmax(), images[stored].iloc[0]
        raise InputError(
            f"{file}: the means of the ROIs of image {image} are {height:.0f} above the same ROIs in other images; "
            "convert all rows to HU, or all to HU + 1024"
        )


def _check_copies(tables: Mapping[Path, pd.DataFrame], conditions: Sequence[str]) -> None:
    """Refuse repeats whose features agree in every digit: the same image under two names."""
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
            f"row {first['row']} (image {first['image']}) for ROI {second['roi']}; keep one of these images"
        )
