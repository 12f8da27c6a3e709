"""Features recordings as the references that simulated features are set against: PCA markers and scores."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from ..base.errors import InputError
from ..features.names import features_of
from ..features.stored import to_hu
from ..statistics import repeats as repeats_of
from .features import FeaturesRecording

PER = ("image", "condition")
MINIMUM_GROUPS = 2  # to be compared with each other
MINIMUM_IMAGES = 2  # of a group: the rank-sum test knows no spread of a single one


def in_hu(recording: FeaturesRecording) -> pd.DataFrame:
    """The repeats with first-order features in HU (to_hu), whatever offset they were extracted with."""
    return to_hu(recording.repeats, recording.stored_offset_hu)


def with_group(table: pd.DataFrame, conditions: Sequence[str]) -> pd.DataFrame:
    """A table of features with a column `group`: 1, 2, ... for each combination of conditions, in their sorted order.

    Without conditions all images are group 1. A condition of the name group, as the tandem study has, is replaced by
    its number in order.
    """
    if not conditions:
        return table.assign(group=1)
    return table.assign(group=table.groupby(list(conditions)).ngroup() + 1)


def reference_features(
    table: pd.DataFrame, conditions: Sequence[str], per: str = "image", named: bool = False
) -> pd.DataFrame:
    """Measured features for `statistics.pca.project`.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, in HU.
    conditions : sequence of str
        Columns.
    per : {"image", "condition"}, optional
        "image": every repeat; "condition": the mean over the repeats of each condition and ROI.
    named : bool, optional
        Whether a column `condition` has the values of `conditions` as text.

    Returns
    -------
    DataFrame
        Columns group, roi, tissue_class and the features that the table has.

    Raises
    ------
    InputError
        For another `per`, and conditions that are no columns.
    """
    if per not in PER:
        raise InputError(f"reference: {per!r} is not known; choose from {', '.join(PER)}")
    if missing := [name for name in conditions if name not in table]:
        raise InputError(f"reference: {missing[0]!r} is no column of the features; there are {', '.join(table)[:200]}")
    columns = ["group", "roi", "tissue_class"]
    if named and len(conditions):
        columns.append("condition")
        text = table[list(conditions)].apply(lambda row: ", ".join(map(_shown, row)), axis=1)
        table = table.assign(condition=text)
    table = with_group(table, conditions)[[*columns, *features_of(table)]]
    return table if per == "image" else table.groupby(columns, sort=False).mean().reset_index()


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def has_scores(recording: FeaturesRecording) -> bool:
    """Whether at least two of its conditions have at least two images."""
    return int((recording.images_per_condition() >= MINIMUM_IMAGES).sum()) >= MINIMUM_GROUPS


def stability_scores(recording: FeaturesRecording, repeats: int, **options) -> pd.DataFrame:
    """Stability and discriminative power over the recording's conditions, for `statistics.ranking.overlap`.

    Conditions of a single image are left out. Values are as in the files, as were those published.

    Parameters
    ----------
    repeats : int
        Images of each condition that are taken at random, again and again (`statistics.repeats.draws`); all conditions
        have as many as the smallest has, if that is less.
    **options
        Of `statistics.wilcoxon.scores`: test, threshold, compare.

    Returns
    -------
    DataFrame
        As `statistics.repeats.draws` gives it.

    Raises
    ------
    InputError
        If fewer than two conditions remain, and what wilcoxon.scores raises.
    """
    name = f"recording {recording.name}"
    if not has_scores(recording):
        raise InputError(
            f"{name}: stability needs at least {MINIMUM_GROUPS} conditions with at least {MINIMUM_IMAGES} images each; "
            "use it without scores, or name the columns that tell its conditions apart under features.conditions"
        )
    table = with_group(recording.repeats, recording.conditions)
    images = table.groupby("group")["image"].transform("nunique")
    return repeats_of.draws(
        table[images >= MINIMUM_IMAGES].reset_index(drop=True),
        recording.features,
        repeats,
        unit="image",
        source=name,
        **options,
    )


def select_rows(table: pd.DataFrame, conditions: dict, source: str) -> pd.DataFrame:
    """The rows of a recording's table whose condition columns have these values, the others' values being free.

    Parameters
    ----------
    conditions : dict
        Value by column.
    source : str
        What the message begins with.

    Raises
    ------
    InputError
        For a column that is not there, or values that no row has.
    """
    chosen = table
    for name, value in conditions.items():
        if name not in table:
            raise InputError(f"{source}: has no column {name}; there are {', '.join(map(str, table.columns[:8]))}")
        there = ", ".join(map(str, chosen[name].unique()))
        text = not pd.api.types.is_numeric_dtype(chosen[name])  # a kernel of 30 is the text 30, YAML's 30 a number
        chosen = chosen[chosen[name] == (str(value) if text else value)]
        if chosen.empty:
            raise InputError(f"{source}: no images with {name} {value}; there are {there}")
    return chosen
