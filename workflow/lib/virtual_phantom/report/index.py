"""Render the first page of a study (index.html): results, warnings, figures, tables and next steps.

The page is in the folder of the results and links to their files.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from markupsafe import Markup

from ..features import MINIMUM_GREY_LEVELS, MINIMUM_VOXELS
from ..figures import trust_map
from ..io.documents import DIAGNOSIS, read_document
from ..io.files import read_csv
from ..statistics import EXTRACTION
from ..statistics.extraction_settings import wide_table
from ..statistics.robustness import between_protocols
from .answer import TITLES, agreement_text, controls_answer, extraction_answer, robustness_answer
from .html import COLORS, OTHER_COLOR
from .study import ReportFigure, caption, render_study

SHORT = 10  # longer lists of features are folded
FEW_ROIS = 10  # with fewer regions, the page says that intervals are wide
NARROW = 900  # pixels; in narrower windows the curves are below the map
HEAT_MAP = "trust_map"  # figure of the heat map
EXTRACTED = "extraction.csv"  # features with all extraction settings
FIRST_ROWS = 5  # rows of each table that the page shows
# Tables with one row per feature are sorted by the first of these columns that they have, instead of by name.
MOST_STABLE = ("ci95_low", "stable_by", "stability_percent")
FEW_REPEATS = 5  # with so few repeats, |W| exceeds 2 only if nearly all values of two groups are ordered


def index_page(
    folder: Path,
    figures: Sequence[ReportFigure],
    tables: Sequence[tuple[str, Path]],
    diagnoses: Sequence[Path],
    config: Mapping,
    commands: Mapping[str, str],
    other_pages: Mapping[str, str] | None = None,
    pairs: Sequence[Mapping] = (),
    impossible: Sequence[str] = (),
) -> str:
    """Render the page as HTML.

    Parameters
    ----------
    folder : Path
        Folder of the results and of the page.
    tables : sequence of (str, Path)
        Titles and CSV files. The page summarizes trust.csv, controls.csv, features.csv and the tables of comparisons,
        if they are present.
    diagnoses : sequence of Path
        Reports, each next to its diagnosis.json.
    commands : mapping of str to str
        {purpose: command}, next steps first.
    other_pages : mapping of str to str, optional
        {title: address} of other pages in the same folder.
    pairs : sequence of mapping, optional
        Pairs of settings in trust.csv (`study.changes`), for curves of the features. Pairs of extraction settings need
        extraction.csv in `folder`.
    impossible : sequence of str, optional
        A sentence for each requested analysis that the study does not allow.
    """
    frames = {path.stem: read_csv(path) for _, path in tables}
    addresses = {path.stem: relative(path, folder) for _, path in tables}
    trust, features = frames.get("trust"), frames.get("features")
    sections: dict[str, list] = {}
    comparisons = {}
    for figure in figures:
        name = figure.path.stem
        if name == HEAT_MAP and trust is not None:
            continue  # the answer has the interactive one
        entry = {"title": figure.title, "path": relative(figure.path, folder), "caption": caption(figure, config)}
        entry["comparison"] = None
        if (table := f"{name}_features") in frames:
            text = agreement_text(frames[table], frames[name])
            entry["comparison"] = {"id": name, "text": text, "table": addresses[table]}
            comparisons[name] = {"title": figure.title, "summary": text.partition(" The mean agrees if")[0]}
        sections.setdefault(figure.section, []).append(entry)
    answer = chart = None
    if trust is not None:
        answer = robustness_answer(trust)
    if answer and (answer["rois"] > 1 or answer["stable"] is not None):
        limits = trust_map.cut_offs(trust, config["analyses"]["stability"]["cut_offs"]["ccc"])
        names = list(trust["feature"].unique())
        curves = _curves(features, names, pairs if features is not None else (), folder)
        chart = json.dumps(trust_map.page_chart(trust, limits, curves)).replace("<", r"\u003c")
    return render_study(
        "index",
        config,
        answer=answer,
        TITLES=TITLES,
        SHORT=SHORT,
        FEW_ROIS=FEW_ROIS,
        NARROW=NARROW,
        chart=chart and Markup(chart),
        bundle=chart and Markup(trust_map.bundle()),
        controls=controls_answer(frames["controls"]) if "controls" in frames else None,
        impossible=impossible,
        extraction=extraction_answer(frames["extraction_settings"], frames["extraction_choice"])
        if "extraction_settings" in frames
        else None,
        comparisons=comparisons,
        verdicts=[verdict(path, folder) for path in diagnoses],
        warnings=[] if features is None else study_warnings(features, trust),
        sections=sections,
        tables=[
            {"title": title, "path": relative(path, folder), "rows": len(frame), "first": first_rows(frame)}
            for (title, path), frame in zip(tables, frames.values(), strict=True)
        ],
        commands=commands,
        other_pages=other_pages or {},
        folder=str(folder),
    )


def _curves(
    features: pd.DataFrame | None, names: Sequence[str], pairs: Sequence[Mapping], folder: Path
) -> dict[str, list[dict]]:
    """Return the data sets of the curves in all settings, extraction settings among them."""
    extracted = [pair for pair in pairs if pair["kind"] == EXTRACTION]
    curves = trust_map.feature_curves(features, names, [pair for pair in pairs if pair["kind"] != EXTRACTION])
    if extracted:
        table = wide_table(read_csv(folder / EXTRACTED))
        known = [name for name in names if name in table]
        more = trust_map.feature_curves(table, known, extracted, start=len(curves["settings"]))
        curves = {name: [*rows, *more[name]] for name, rows in curves.items()}
    return curves


def study_warnings(features: pd.DataFrame, trust: pd.DataFrame | None) -> list[str]:
    """List warnings about small ROIs, few gray levels and few repeats.

    Parameters
    ----------
    features : DataFrame
        Features of all images, with columns roi, n_voxels and grey_levels.
    trust : DataFrame or None
        From `statistics.robustness.robustness_table`.
    """
    texts = []
    for roi, rows in features.groupby("roi", sort=False):
        voxels, levels = int(rows["n_voxels"].min()), rows["grey_levels"] < MINIMUM_GREY_LEVELS
        if voxels < MINIMUM_VOXELS:
            texts.append(
                f"ROI {roi} has {voxels} voxels. Texture features need at least {MINIMUM_VOXELS}: use a larger ROI or "
                "smaller voxels."
            )
        if levels.any():
            texts.append(
                f"ROI {roi} has fewer than {MINIMUM_GREY_LEVELS} gray levels in {levels.sum()} of {len(rows)} images. "
                "Its GLCM features are not meaningful in these images: use a smaller bin width."
            )
    if trust is not None:
        between = between_protocols(trust)
        repeats = between["repeats"].min() if len(between) else FEW_REPEATS + 1
        if repeats <= FEW_REPEATS:
            texts.append(
                f"There are {repeats} repeats per group. By W, features seem more stable than with ten repeats, which "
                "detect smaller differences between protocols."
            )
    return texts


def verdict(report: Path, folder: Path) -> dict:
    """Return recording, verdict, sentence and color of a diagnosis, and the address of its report."""
    content = read_document(report.parent / "diagnosis.json", DIAGNOSIS)
    shown = {key: content[key] for key in ("recording", "verdict", "sentence")}
    return shown | {"color": COLORS.get(content["verdict"], OTHER_COLOR), "path": relative(report, folder)}


def first_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the first rows of a table, sorted by stability if it has one row per feature."""
    by = next((name for name in MOST_STABLE if name in frame), None)
    if by and "feature" in frame and frame["feature"].is_unique:
        frame = frame.sort_values(by, ascending=False, kind="stable")
    return frame.head(FIRST_ROWS)


def relative(path: Path, folder: Path) -> str:
    """Return the address of a file relative to the folder of the page."""
    return path.relative_to(folder).as_posix()
