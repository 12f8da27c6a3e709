"""Features recordings as the references that simulated features are set against: PCA markers and scores."""

from __future__ import annotations

import pandas as pd

from .. import measured
from ..errors import InputError
from ..statistics import wilcoxon
from .features import FeaturesRecording

PER = ("image", "condition")
MINIMUM_GROUPS = 2
MINIMUM_IMAGES = 2  # of a group: the rank-sum test knows no spread of a single one


def grouped(recording: FeaturesRecording) -> pd.DataFrame:
    """The repeats with a column `group`: 1, 2, ... for each combination of conditions, in their sorted order.

    Values are as in the files. Without conditions all images are group 1. A condition of the name group, as the tandem
    study has, is replaced by its number in order.
    """
    table = recording.repeats
    if not recording.conditions:
        return table.assign(group=1)
    return table.assign(group=table.groupby(list(recording.conditions)).ngroup() + 1)


def reference(recording: FeaturesRecording, per: str = "image") -> pd.DataFrame:
    """Measured features for `statistics.pca.project`: columns group, roi, tissue_class and the recording's features.

    per   "image": every repeat; "condition": the mean over the repeats of each condition and ROI
    First-order features are in HU (measured.to_hu), whatever offset they were extracted with.
    Raises InputError for another `per`, or features that cannot be brought to HU.
    """
    if per not in PER:
        raise InputError(f"reference: {per!r} is not known; choose from {', '.join(PER)}")
    table = measured.to_hu(grouped(recording), recording.stored_offset_hu)
    columns = ["group", "roi", "tissue_class"]
    table = table[[*columns, *recording.features]]
    return table if per == "image" else table.groupby(columns, sort=False).mean().reset_index()


def has_scores(recording: FeaturesRecording) -> bool:
    """Whether at least two of its conditions have at least two images."""
    return int((recording.images_per_condition() >= MINIMUM_IMAGES).sum()) >= MINIMUM_GROUPS


def scores(recording: FeaturesRecording, **options) -> pd.DataFrame:
    """Stability and discriminative power over the recording's conditions, for `statistics.ranking.overlap`.

    options   of `statistics.wilcoxon.scores`: test, threshold, compare
    Conditions of a single image are left out. Values are as in the files, as were those published.
    Raises InputError if fewer than two conditions remain, and what wilcoxon.scores raises.
    """
    name = f"recording {recording.name}"
    if not has_scores(recording):
        raise InputError(
            f"{name}: stability needs at least {MINIMUM_GROUPS} conditions with at least {MINIMUM_IMAGES} images each; "
            "use it without scores, or name the columns that tell its conditions apart under features.conditions"
        )
    table = grouped(recording)
    images = table.groupby("group")["image"].transform("nunique")
    return wilcoxon.scores(table[images >= MINIMUM_IMAGES], recording.features, source=name, **options)
