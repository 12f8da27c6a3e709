"""The first page of a study: what it says, what to beware of, and where everything lies.

It lies in the folder of the results and points to their files, which it does not contain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import yaml

from .. import __version__
from ..features.extraction import MINIMUM_GREY_LEVELS, MINIMUM_VOXELS
from ..figures.style import TRIAL
from ..io.documents import DIAGNOSIS, read_document
from ..io.files import read_csv
from ..statistics.trust import percent
from .answer import MOST_FEATURES, agreement, answer, tissues
from .html import COLOURS, OTHER_COLOUR, render
from .study import Shown, caption, cell, packages

NAMES = {"icc_2_1": "ICC(2,1)", "icc_3_1": "ICC(3,1)", "ccc": "CCC", "cv": "cv", "qcd": "qcd"}  # of measures beside W
FIRST_ROWS = 5  # of each table
# A table with a row per feature is ordered by the first of these that it has: else its first rows were those of the
# alphabet, which say nothing.
MOST_STABLE = ("ci95_low", "stable_by", "stability_percent")
MOST_CLASSES = 5  # of tissue beside the interval in one table: more make it wider than the page, and get their own
FEW_REPEATS = 5  # up to here two groups need nearly all of their values in order for |W| to pass 2


@dataclass(frozen=True)
class Linked:
    """A file that the page points to."""

    title: str
    path: Path


def page(
    folder: Path,
    figures: Sequence[Shown],
    tables: Sequence[Linked],
    diagnoses: Sequence[Path],
    config: Mapping,
    commands: Mapping[str, str],
    beside: Mapping[str, str] | None = None,
) -> str:
    """The page as HTML.

    Parameters
    ----------
    folder : Path
        Of the results, where the page will lie.
    tables : sequence of Linked
        CSV files. What the page says is taken from trust.csv, stable_features.csv, stability.csv, features.csv and the
        tables of comparisons, if they are among them.
    diagnoses : sequence of Path
        Reports; the verdict is in diagnosis.json beside each.
    config : mapping
        The complete configuration.
    commands : mapping of str to str
        What they do: the command, what to do first first.
    beside : mapping of str to str, optional
        Pages in the same folder: what they are called, and their addresses.
    """
    frames = {one.path.stem: read_csv(one.path) for one in tables}
    addresses = {one.path.stem: relative(one.path, folder) for one in tables}
    trust, features = frames.get("trust"), frames.get("features")
    sections: dict[str, list] = {}
    compared = {}
    for figure in figures:
        name = figure.path.stem
        shown = {"title": figure.title, "path": relative(figure.path, folder), "caption": caption(figure, config)}
        shown["compared"] = None
        if (table := f"{name}_features") in frames:
            shown["compared"] = {
                "id": name,
                "said": agreement(frames[table], frames[name]),
                "table": addresses[table],
            }
            compared[name] = figure.title
        sections.setdefault(figure.section, []).append(shown)
    return render(
        "index",
        {"cell": cell, "percent": percent},
        NAMES=NAMES,
        MOST_FEATURES=MOST_FEATURES,
        MOST_CLASSES=MOST_CLASSES,
        answer=None
        if trust is None
        else answer(trust, frames.get("stable_features"))
        | {"tissues": tissues(trust, frames.get("stability"), features, config["statistics"]["compare"])},
        compared=compared,
        verdicts=[verdict(path, folder) for path in diagnoses],
        warnings=[] if features is None else warnings(features, trust),
        sections=sections,
        tables=[
            {"title": one.title, "path": relative(one.path, folder), "rows": len(frame), "first": first_rows(frame)}
            for one, frame in zip(tables, frames.values(), strict=True)
        ],
        commands=commands,
        beside=beside or {},
        folder=str(folder),
        trial=config["trial"],
        TRIAL=TRIAL,
        config=yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True),
        version=__version__,
        packages=packages(),
    )


def warnings(features: pd.DataFrame, trust: pd.DataFrame | None) -> list[str]:
    """What to beware of, a sentence each.

    Parameters
    ----------
    features : DataFrame
        Of all images, with columns roi, n_voxels and grey_levels.
    trust : DataFrame or None
        Of `statistics.trust.table`.
    """
    said = []
    for roi, rows in features.groupby("roi", sort=False):
        voxels, levels = int(rows["n_voxels"].min()), rows["grey_levels"] < MINIMUM_GREY_LEVELS
        if voxels < MINIMUM_VOXELS:
            said.append(
                f"ROI {roi} has {voxels} voxels, fewer than the {MINIMUM_VOXELS} that texture features need to mean "
                "anything. Use a larger ROI or smaller voxels."
            )
        if levels.any():
            said.append(
                f"ROI {roi} has fewer than {MINIMUM_GREY_LEVELS} grey levels in {levels.sum()} of {len(rows)} images. "
                "Its GLCM features say little there."
            )
    if trust is not None:
        row = trust.iloc[0]
        if row["repeats"] <= FEW_REPEATS:
            said.append(
                f"There are {row['repeats']} repeats a group. They miss differences between protocols that ten repeats "
                "would show, so that features seem more stable."
            )
    return said


def verdict(report: Path, folder: Path) -> dict:
    """What a diagnosis found: recording, verdict, sentence, colour, and the address of its report."""
    found = read_document(report.parent / "diagnosis.json", DIAGNOSIS)
    colour = COLOURS.get(found["verdict"], OTHER_COLOUR)
    return {**{key: found[key] for key in ("recording", "verdict", "sentence")}, "colour": colour} | {
        "path": relative(report, folder)
    }


def first_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """The first rows of a table; of one of features' stability the most stable."""
    by = next((name for name in MOST_STABLE if name in frame), None)
    if by and "feature" in frame and frame["feature"].is_unique:
        frame = frame.sort_values(by, ascending=False, kind="stable")
    return frame.head(FIRST_ROWS)


def relative(path: Path, folder: Path) -> str:
    """A file's address on a page in a folder."""
    return path.relative_to(folder).as_posix()
