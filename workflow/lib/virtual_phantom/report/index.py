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
from ..statistics.stability_measures import CUT_OFFS
from ..statistics.trust import percent
from .html import COLOURS, OTHER_COLOUR, render
from .study import Shown, caption, cell, packages

NAMES = {"icc_2_1": "ICC(2,1)", "icc_3_1": "ICC(3,1)", "ccc": "CCC", "cv": "cv", "qcd": "qcd"}  # of measures beside W
FIRST_ROWS = 5  # of each table
MOST_FEATURES = 10  # in the answer
FEW_REPEATS = 5  # up to here two groups need nearly all of their values in order for |W| to pass 2


@dataclass(frozen=True)
class Linked:
    """A file that the page points to.

    Attributes
    ----------
    title : str
    path : Path
    """

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
    figures : sequence of Shown
    tables : sequence of Linked
        CSV files. What the page says is taken from trust.csv, stable_features.csv and features.csv, if they are among
        them.
    diagnoses : sequence of Path
        Reports; the verdict is in diagnosis.json beside each.
    config : mapping
        The complete configuration.
    commands : mapping of str to str
        What they do: the command. The first is that of the study itself.
    beside : mapping of str to str, optional
        Pages in the same folder: what they are called, and their addresses.

    Returns
    -------
    str
    """
    frames = {one.path.stem: read_csv(one.path) for one in tables}
    trust, features = frames.get("trust"), frames.get("features")
    sections: dict[str, list] = {}
    for figure in figures:
        sections.setdefault(figure.section, []).append(
            {"title": figure.title, "path": relative(figure.path, folder), "caption": caption(figure, config)}
        )
    return render(
        "index",
        {"cell": cell, "percent": percent},
        NAMES=NAMES,
        answer=None if trust is None else answer(trust, frames.get("stable_features")),
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
        config_trial=config["trial"],
        TRIAL=TRIAL,
        config=yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True),
        version=__version__,
        packages=packages(),
    )


def answer(trust: pd.DataFrame, measures: pd.DataFrame | None) -> dict:
    """Which features to trust.

    Parameters
    ----------
    trust : DataFrame
        Of `statistics.trust.table`.
    measures : DataFrame or None
        Of `statistics.stability_measures.by_feature`: beside W.

    Returns
    -------
    dict
        rests_on (a row, for the numbers that all share), features (how many), counts (of each verdict), best (rows of
        the most stable ones), others (a measure beside W: how many features are stable by it).
    """
    order = trust.sort_values(["ci95_low", "stability_percent", "feature"], ascending=[False, False, True])
    others = {} if measures is None else {name: int((measures[f"stable_{name}"] == "yes").sum()) for name in CUT_OFFS}
    others.pop("w_stability_percent", None)
    return {
        "rests_on": trust.iloc[0].to_dict(),
        "features": len(trust),
        "counts": {name: int((trust["stable"] == name).sum()) for name in ("yes", "no", "undecided")},
        "best": order.head(MOST_FEATURES).to_dict("records"),
        "others": others,
    }


def warnings(features: pd.DataFrame, trust: pd.DataFrame | None) -> list[str]:
    """What to beware of, a sentence each.

    Parameters
    ----------
    features : DataFrame
        Of all images, with columns roi, n_voxels and grey_levels.
    trust : DataFrame or None
        Of `statistics.trust.table`.

    Returns
    -------
    list of str
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
    """The first rows of a table."""
    return frame.head(FIRST_ROWS)


def relative(path: Path, folder: Path) -> str:
    """A file's address on a page in a folder."""
    return path.relative_to(folder).as_posix()
