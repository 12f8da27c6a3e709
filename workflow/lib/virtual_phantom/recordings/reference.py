"""Recorded features as references for simulated ones: PCA markers and stability scores."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from ..base.errors import InputError
from ..features.hu_offset import convert_to_hu
from ..features.names import features_of
from ..statistics.repeats import score_draws
from .features import FeaturesRecording

MINIMUM_GROUPS = 2  # a comparison needs two
MINIMUM_IMAGES = 2  # per group: the rank-sum test needs a spread


def in_hu(recording: FeaturesRecording) -> pd.DataFrame:
    """Return the repeats with first-order features converted to HU by `convert_to_hu`."""
    return convert_to_hu(recording.repeats, recording.stored_offset_hu)


def with_group(table: pd.DataFrame, conditions: Sequence[str]) -> pd.DataFrame:
    """Return a table of features with a column `group`: 1, 2, ... for the sorted combinations of conditions.

    Without conditions, all images are group 1. The groups replace a condition named group, as in the tandem study.
    """
    if not conditions:
        return table.assign(group=1)
    return table.assign(group=table.groupby(list(conditions)).ngroup() + 1)


def reference_features(table: pd.DataFrame, conditions: Sequence[str], named: bool = False) -> pd.DataFrame:
    """Return measured features for `statistics.pca.project`: means over the repeats of each condition and ROI.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, in HU.
    named : bool, optional
        Whether to add a column `condition` with the values of `conditions` as text.

    Returns
    -------
    DataFrame
        Columns group, roi, tissue_class and the features of the table.

    Raises
    ------
    InputError
        For conditions that are not columns.
    """
    if missing := [name for name in conditions if name not in table]:
        raise InputError(
            f"reference: {missing[0]!r} is not a column of the features; choose from {', '.join(table)[:200]}"
        )
    columns = ["group", "roi", "tissue_class"]
    if named and len(conditions):
        columns.append("condition")
        text = table[list(conditions)].apply(lambda row: ", ".join(map(_shown, row)), axis=1)
        table = table.assign(condition=text)
    table = with_group(table, conditions)[[*columns, *features_of(table)]]
    return table.groupby(columns, sort=False).mean().reset_index()


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def stability_scores(recording: FeaturesRecording, repeats: int, **options) -> pd.DataFrame:
    """Return stability and discriminative power over the recording's conditions, for `statistics.ranking.overlap`.

    Conditions with a single image are ignored. Values are used as stored in the files, like the published scores.

    Parameters
    ----------
    repeats : int
        Images per condition in each random subset (`statistics.repeats.subsamples`). If a condition has fewer images,
        all conditions use that number.
    **options
        Arguments of `statistics.wilcoxon.scores`: test, threshold, compare.

    Returns
    -------
    DataFrame
        As returned by `statistics.repeats.score_draws`.

    Raises
    ------
    InputError
        If fewer than two conditions have enough images, and as wilcoxon.scores raises.
    """
    name = f"recording {recording.name}"
    if (recording.images_per_condition() >= MINIMUM_IMAGES).sum() < MINIMUM_GROUPS:
        raise InputError(
            f"{name}: stability needs at least {MINIMUM_GROUPS} conditions with at least {MINIMUM_IMAGES} images each; "
            "list the columns that distinguish conditions under features.conditions, or remove its scores"
        )
    table = with_group(recording.repeats, recording.conditions)
    images = table.groupby("group")["image"].transform("nunique")
    table = table[images >= MINIMUM_IMAGES].reset_index(drop=True)
    return score_draws(table, recording.features, repeats, unit="image", source=name, **options)


def select_rows(table: pd.DataFrame, conditions: dict, source: str) -> pd.DataFrame:
    """Select the rows of a recording's table with these values in its condition columns ({column: value}).

    Raises
    ------
    InputError
        For a missing column, or values that no row has.
    """
    chosen = table
    for name, value in conditions.items():
        if name not in table:
            raise InputError(f"{source}: has no column {name}; choose from {', '.join(map(str, table.columns[:8]))}")
        present = ", ".join(map(str, chosen[name].unique()))
        text = not pd.api.types.is_numeric_dtype(chosen[name])  # YAML reads kernel: 30 as a number, tables as text
        chosen = chosen[chosen[name] == (str(value) if text else value)]
        if chosen.empty:
            raise InputError(f"{source}: no images with {name} {value}; choose from {present}")
    return chosen
