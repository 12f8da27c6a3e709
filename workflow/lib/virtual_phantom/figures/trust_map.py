"""Heat map of features and kinds of change, as a Vega-Lite specification for pages, PNG and PDF [1]_.

One specification gives the figure for papers and the interactive chart of the page. The chart has a choice of measure
and region, details on hover, and the values of the selected feature. vl-convert-python contains Vega-Lite and draws PNG
and PDF without a browser.

References
----------
.. [1] Satyanarayan et al., IEEE Trans. Vis. Comput. Graph. 23, 341, 2017: Vega-Lite.
"""

from __future__ import annotations

import contextlib
import os
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import vl_convert

from ..base.cache_folders import temporary_cache, user_cache
from ..base.errors import InputError
from ..base.names import label
from ..io.files import check_unchanged, replacing
from ..statistics.changes import REPEATABILITY_CUT_OFF
from ..statistics.robustness import SIZE, USES, acquisition_changes, setting_key, setting_rows
from . import style

VEGA_LITE = "6.4"  # version of the specification, in vl-convert-python
ALL_REGIONS = "all regions"
NAMES = {
    "icc": "ICC (2,1); random repeats: ICC (1,1)",
    "ccc": "concordance correlation (CCC)",
    "repeatability": "repeatability coefficient / SD between tissues",
    "w": "share of comparisons with |W| < threshold",
}
COLUMNS = {"icc": "icc", "ccc": "ccc", "repeatability": "repeatability", "w": "stability"}
ROW, COLUMN = 11, 30  # pixels
FONT = 10
CURVE_WIDTH, CURVE_HEIGHT = 420, 260
# In a narrow window, the curves are below the map and start this far to the left of its cells, below the names.
NARROW_LEFT, NARROW_WIDTH = 165, 290
WRAPPED = 62  # characters per line of text below the curves
SHORT_LEGEND = 150  # pixels; shorter legends have fewer numbers
FEW_ROWS = 6  # the name of a class with fewer features is horizontal
MOST_LINES = 2  # contexts of a change, such as protocols with several noise levels, whose curves are shown
# Shapes of the regions. Their number and the number of colors have no common factor, so that 56 regions look different.
SHAPES = ("circle", "square", "triangle-up", "cross", "diamond", "triangle-right", "triangle-down")
FEW_DIGITS = 4  # significant digits of values on the page
COEFFICIENT = 1.96 * np.sqrt(2)  # of repeatability, which is this number times sqrt(1 / ICC - 1) for equal spreads


def cut_offs(trust: pd.DataFrame, ccc: float) -> dict[str, float]:
    """Return the cut-off of each measure, for W as a share."""
    first = trust.iloc[0]
    return {
        "icc": float(first["icc_cut_off"]),
        "ccc": float(ccc),
        "repeatability": REPEATABILITY_CUT_OFF,
        "w": float(first["cut_off_percent"]) / 100,
    }


def measures(trust: pd.DataFrame) -> list[str]:
    """Return the measures that are defined, the default first; a single region has only W."""
    return list(COLUMNS) if trust["rois"].iloc[0] > 1 else ["w"]


def cells(trust: pd.DataFrame) -> list[dict]:
    """Return the cells of the heat map: names, words, and {measure}|{region} with |low and |high."""
    regions = region_names(trust)
    rows = []
    for row in trust.to_dict("records"):
        cell = {key: row[key] for key in ("feature", "family", "change", "sentence", "rois", "pairs")}
        cell["name"] = _name(row)
        cell["heading"] = f"{style.feature_label(row['feature'])}: {row['change']}"
        paragraphs = (row["sentence"], f"All changes: {row['use']}. {row['reason'].split(' Lowest for ')[0]}")
        cell["words"] = "\n".join(line for text in paragraphs for line in textwrap.wrap(text, WRAPPED))
        for measure, column in COLUMNS.items():
            scale = 100 if measure == "w" else 1
            own = "stability_percent" if measure == "w" else column
            low, high = ("ci95_low", "ci95_high") if measure == "w" else (f"{column}_low", f"{column}_high")
            key = f"{measure}|{ALL_REGIONS}"
            cell |= {key: row[own] / scale, f"{key}|low": row[low] / scale, f"{key}|high": row[high] / scale}
            for region in regions:
                cell[f"{measure}|{region}"] = row[f"{column}_of_{region}"] / scale
        rows.append({key: _short(value) for key, value in cell.items() if not _missing(value)})
    return rows


def region_names(trust: pd.DataFrame) -> list[str]:
    """Return the tissue classes of a robustness table; none if there is only one."""
    found = [name.removeprefix("icc_of_") for name in trust if name.startswith("icc_of_")]
    return found if len(found) > 1 else []


def _missing(value) -> bool:
    return isinstance(value, float) and np.isnan(value)


def _short(value):
    return float(f"{value:.{FEW_DIGITS}g}") if isinstance(value, float) else value


def order(trust: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Return families and names of features, most robust first: by use, robust changes, then lowest ICC."""
    grouped = acquisition_changes(trust).groupby("feature", sort=False)
    one = grouped.agg(
        family=("family", "first"),
        use=("use", "first"),
        lowest=("icc", "min"),
        yes=("robust", lambda x: (x == "yes").sum()),
    ).reset_index()
    one["rank"] = one["use"].map({use: place for place, use in enumerate(USES)})
    one = one.sort_values(["rank", "yes", "lowest"], ascending=[True, False, False], kind="stable")
    families = one.groupby("family")["rank"].mean().sort_values(kind="stable")
    return list(families.index), [_name(row) for row in one.to_dict("records")]


def _name(row: Mapping) -> str:
    """Return the label of a feature in its row of the map, below the name of its class."""
    family = style.family_label(row["feature"].split("_")[1])
    name = style.feature_label(row["feature"]).replace(f"{family} ", "", 1)
    return name + (" †" if row["use"] == SIZE else "")


def heat_map(trust: pd.DataFrame, limits: Mapping[str, float], *, trial: bool = False) -> dict:
    """Return the Vega-Lite specification of the figure: the default measure of all regions.

    Parameters
    ----------
    trust : DataFrame
        From `statistics.robustness.robustness_table`.
    limits : mapping of str to float
        From `cut_offs`.
    """
    chosen = [{"name": "measure", "value": measures(trust)[0]}, {"name": "region", "value": ALL_REGIONS}]
    title = {"title": {"text": style.TRIAL, "color": style.VERMILLION}} if trial else {}
    resolve = {"scale": {"y": "independent"}}
    content = {**title, **_map(trust), "datasets": {"cells": cells(trust)}, "resolve": resolve}
    return _specification(limits, chosen, content, FONT)


def page_chart(trust: pd.DataFrame, limits: Mapping[str, float], curves: Mapping[str, Sequence[Mapping]]) -> dict:
    """Return the interactive chart of a page: Vega specifications for `wide` and `narrow` windows, and their `data`.

    Readers choose measure and region, and select a cell to see the values of its feature beside the map.

    Parameters
    ----------
    trust, limits
        As for `heat_map`.
    curves : mapping
        From `feature_curves`.
    """
    regions = [ALL_REGIONS, *region_names(trust)]
    params = [
        _choice("measure", measures(trust), [NAMES[name] for name in measures(trust)]),
        _choice("region", regions, [label(region) for region in regions]),
    ]
    resolve = {"scale": {"color": "independent", "shape": "independent"}}
    first = _first_cell(trust)
    specifications = {}
    narrow = {"column": 20, "angle": -90}
    for name, columns, size, curve in (("wide", 2, {}, ()), ("narrow", 1, narrow, (NARROW_WIDTH, NARROW_LEFT))):
        views = [_map(trust, first, **size), _curves(*curve)]
        content = {"concat": views, "columns": columns, "spacing": 30, "align": "none", "resolve": resolve}
        specification = _specification(limits, params, content, FONT if columns == 2 else FONT - 1)
        specifications[name] = _with_colored_shapes(vl_convert.vegalite_to_vega(specification, vl_version=VEGA_LITE))
    return specifications | {"data": {"cells": cells(trust), **curves}}


def _with_colored_shapes(group: dict) -> dict:
    """Give the legend of shapes in a Vega specification the colors of the same regions; Vega-Lite draws two legends."""
    for legend in group.get("legends", []):
        if "shape" in legend:
            legend["fill"] = legend["shape"].replace("shape", "color")
            legend["encode"]["symbols"]["update"] = {"opacity": {"value": 1}}
    for mark in group.get("marks", []):
        _with_colored_shapes(mark)
    return group


def _specification(limits: Mapping[str, float], params: list[dict], content: dict, font: int) -> dict:
    return {
        "$schema": f"https://vega.github.io/schema/vega-lite/v{VEGA_LITE}.json",
        "params": [{"name": "limits", "value": dict(limits)}, *params],
        **content,
        "config": {
            "font": "sans-serif",
            "axis": {"labelFontSize": font, "titleFontSize": FONT, "labelLimit": 260},
            "header": {"labelFontSize": FONT, "labelFontWeight": "bold"},
            "view": {"stroke": None},
            "mark": {"invalid": None},  # cells without a value are gray instead of missing
        },
    }


def _choice(name: str, options: list[str], labels: list[str]) -> dict:
    return {
        "name": name,
        "value": options[0],
        "bind": {"input": "select", "options": options, "labels": labels, "name": f"{name.capitalize()} "},
    }


def _first_cell(trust: pd.DataFrame) -> dict:
    """Return the cell that is selected first: the lowest ICC for a change of settings, if there is one."""
    trust = acquisition_changes(trust)
    moved = trust[trust["change_from"].fillna("") != ""]
    row = (moved if len(moved) else trust).sort_values("icc", kind="stable").iloc[0]
    return {"feature": row["feature"], "change": row["change"]}


def _map(trust: pd.DataFrame, chosen: dict | None = None, *, column: int = COLUMN, angle: int = -45) -> dict:
    """Return the heat map, with a selection that starts with the cell `chosen`."""
    families, names = order(trust)
    value = "datum[measure + '|' + region]"
    better = "measure == 'repeatability' ? ({0} <= limits[measure]) : ({0} >= limits[measure])"
    bound = "measure == 'repeatability' ? datum.high : datum.low"
    number = "isValid({0}) ? format({0}, '.2f') : 'none'"
    coefficient = f"format({COEFFICIENT:.3f} * sqrt(1 / max(datum.value, 0.01) - 1), '.1f')"
    tick = f"measure == 'repeatability' ? {coefficient} : format(datum.value, '.2f')"
    transform = [
        {"calculate": value, "as": "value"},
        {"calculate": "datum[measure + '|' + region + '|low']", "as": "low"},
        {"calculate": "datum[measure + '|' + region + '|high']", "as": "high"},
        # One scale of shades: the repeatability as the ICC with the same ratio of spreads.
        {
            "calculate": f"!isValid(datum.value) ? null : measure == 'repeatability' ? "
            f"1 / (1 + pow(datum.value / {COEFFICIENT:.3f}, 2)) : clamp(datum.value, 0, 1)",
            "as": "shade",
        },
        {"calculate": bound, "as": "bound"},
        {
            "calculate": f"!isValid(datum.value) ? '' "
            f": (isValid(datum.bound) && ({better.format('datum.bound')})) ? '●' "
            f": ({better.format('datum.value')}) ? '○' : ''",
            "as": "mark",
        },
        {"calculate": number.format("datum.value"), "as": "shown"},
        {
            "calculate": "isValid(datum.low) ? format(datum.low, '.2f') + ' to ' + format(datum.high, '.2f') : 'none'",
            "as": "interval",
        },
    ]
    x = {
        "field": "change",
        "type": "nominal",
        "sort": list(dict.fromkeys(trust["change"])),
        "axis": {"orient": "top", "labelAngle": angle, "title": None, "domain": False, "ticks": False},
    }
    y = {"field": "name", "type": "nominal", "sort": names, "axis": {"title": None, "domain": False, "ticks": False}}
    tooltip = [
        {"field": "name", "title": "feature"},
        {"field": "change", "title": "change"},
        {"field": "shown", "title": "value"},
        {"field": "interval", "title": "95 % interval"},
        {"field": "rois", "title": "regions"},
        {"field": "pairs", "title": "pairs of settings"},
        {"field": "sentence", "title": "in words"},
    ]
    length = max(100, column * trust["change"].nunique())
    legend = {
        "title": ["shade: agreement", "(value of the measure)"],
        "orient": "bottom",
        "gradientLength": length,
        "titleLimit": 320,
        "labelExpr": tick,
        "values": [0, 0.25, 0.5, 0.75, 1] if length > SHORT_LEGEND else [0, 0.5, 1],
    }
    rectangle = {
        "mark": {"type": "rect", "stroke": "white", "strokeWidth": 0.5, "tooltip": True},
        "encoding": {
            "color": {
                "condition": {"test": "!isValid(datum.shade)", "value": "#eeeeee"},
                "field": "shade",
                "type": "quantitative",
                "scale": {"scheme": "cividis", "domain": [0, 1]},
                "legend": legend,
            },
            "tooltip": tooltip,
        },
    }
    if chosen:
        rectangle["params"] = [
            {
                "name": "picked",
                "select": {"type": "point", "fields": ["feature", "change"], "toggle": False, "clear": False},
                "value": [chosen],
            }
        ]
        rectangle["encoding"]["stroke"] = {
            "condition": {"param": "picked", "empty": False, "value": "#D55E00"},
            "value": "white",
        }
        rectangle["encoding"]["strokeWidth"] = {
            "condition": {"param": "picked", "empty": False, "value": 2.5},
            "value": 0.5,
        }
    marks = {
        "mark": {"type": "text", "fontSize": FONT - 1, "baseline": "middle", "tooltip": None},
        "encoding": {
            "text": {"field": "mark"},
            "color": {"condition": {"test": "datum.shade > 0.5", "value": "black"}, "value": "white"},
        },
    }
    return {
        "data": {"name": "cells"},
        "transform": transform,
        "facet": {
            "row": {
                "field": "family",
                "sort": families,
                "header": {
                    "title": None,
                    "labelOrient": "left",
                    "labelAngle": -90 if trust.groupby("family")["feature"].nunique().min() >= FEW_ROWS else 0,
                    "labelAlign": "center",
                    "labelPadding": 4,
                },
            }
        },
        "spacing": 4,
        "spec": {
            "width": {"step": column},
            "height": {"step": ROW},
            "encoding": {"x": x, "y": y},
            "layer": [rectangle, marks],
        },
        "resolve": {"scale": {"y": "independent"}},
    }


def _curves(width: int = CURVE_WIDTH, left: int = 0) -> dict:
    """Return the panel with the values of the selected feature in all settings of the selected change.

    A grid of charts aligns their left edges, so that the content starts `left` pixels before the edge.
    """
    picked = {"filter": {"param": "picked", "empty": False}}
    chosen_values = [
        {"filter": "datum.feature == (picked.feature || [''])[0]"},
        {"flatten": ["number", "mean", "sd"]},
        {"calculate": "(picked.change || [''])[0] + '|' + datum.number", "as": "key"},
        {"lookup": "key", "from": {"data": {"name": "settings"}, "key": "key", "fields": ["name", "context", "place"]}},
        {"filter": "isValid(datum.name)"},
        {"calculate": "datum.mean - datum.sd", "as": "below"},
        {"calculate": "datum.mean + datum.sd", "as": "above"},
    ]
    legend = {"orient": "bottom", "columns": 2 if left else 3, "title": None}
    region = {"field": "region", "type": "nominal", "sort": None}
    color = {**region, "scale": {"range": list(style.ON_WHITE)}, "legend": None}
    x = {
        "field": "name",
        "type": "nominal",
        "sort": {"field": "place", "op": "min"},
        "axis": {"title": None, "labelAngle": -30, "labelLimit": 120},
        "scale": {"range": [-left, width - left]},
    }
    detail = [{"field": "region"}, {"field": "context"}]
    axis = {"title": "mean ± SD of repeats", "offset": left, "grid": False}
    y = {"field": "mean", "type": "quantitative", "scale": {"zero": False}, "axis": axis}
    panel = {
        "data": {"name": "curves"},
        "transform": chosen_values,
        "width": width - left,
        "height": CURVE_HEIGHT,
        "encoding": {"x": x},
        "layer": [
            {
                "mark": {"type": "line", "strokeWidth": 1.2},
                "encoding": {
                    "y": y,
                    "color": color,
                    "detail": detail,
                    "strokeDash": {"field": "context", "type": "nominal", "sort": None, "legend": None},
                },
            },
            {
                "mark": {"type": "rule", "opacity": 0.5},
                "encoding": {
                    "y": {"field": "below", "type": "quantitative"},
                    "y2": {"field": "above"},
                    "color": color,
                    "detail": detail,
                },
            },
            {
                "mark": {"type": "point", "filled": True, "size": 35, "opacity": 1},
                "encoding": {
                    "y": y,
                    "color": color,
                    "shape": {**region, "scale": {"range": list(SHAPES)}, "legend": legend},
                    "tooltip": [
                        {"field": "region"},
                        {"field": "name", "title": "setting"},
                        {"field": "context"},
                        {"field": "mean", "format": ".4g"},
                        {"field": "sd", "format": ".3g", "title": "SD of repeats"},
                    ],
                },
            },
        ],
    }
    heading = {
        "data": {"name": "cells"},
        "transform": [picked],
        "width": width - left,
        "height": 14,
        "mark": {"type": "text", "align": "left", "x": -left, "fontSize": FONT + 2, "fontWeight": "bold", "limit": 340},
        "encoding": {"text": {"field": "heading"}},
    }
    reason = {
        "data": {"name": "cells"},
        "transform": [picked],
        "width": width - left,
        "height": 110,
        "mark": {
            "type": "text",
            "align": "left",
            "x": -left,
            "y": 0,
            "baseline": "top",
            "fontSize": FONT,
            "lineBreak": "\n",
        },
        "encoding": {"text": {"field": "words"}},
    }
    return {
        "vconcat": [heading, panel, reason],
        "spacing": 8,
        "resolve": {"scale": {"color": "independent", "shape": "independent"}},
    }


def feature_curves(
    table: pd.DataFrame, features: Sequence[str], pairs: Sequence[Mapping], start: int = 0
) -> dict[str, list[dict]]:
    """Return the data sets of the curves: values of every feature in all settings.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns roi, seed, the columns in `where` of the pairs, and `features`.
    pairs : sequence of mapping
        As in `statistics.robustness.robustness_table`.
    start : int, optional
        Number of the first setting.

    Returns
    -------
    dict of str to list of dict
        * curves: one row per feature and region: lists of setting numbers, means and SDs over repeats
        * settings: one row per change and setting: key ({change}|{number}), name, context (the settings that pairs of
          one kind connect are one line), and place on the axis
    """
    settings, numbers, known = [], {}, {}
    for kind, chains in _chains(pairs).items():
        for chain in sorted(chains, key=len, reverse=True)[:MOST_LINES]:
            first = next(iter(chain.values()))
            context = ", ".join(str(value) for column, value in first["where"].items() if column != "setting")
            for place, (key, setting) in enumerate(chain.items()):
                number = numbers.setdefault(key, start + len(numbers))
                known.setdefault(key, setting)
                settings.append(
                    {"key": f"{kind}|{number}", "name": setting["label"], "context": context, "place": place}
                )
    curves: dict[tuple, dict] = {}
    for key, number in numbers.items():
        grouped = table.loc[setting_rows(table, known[key])].groupby("roi", sort=False)[list(features)]
        means, sds = grouped.mean(), grouped.std().fillna(0.0).to_numpy(float)
        for roi, values, spreads in zip(means.index, means.to_numpy(float), sds, strict=True):
            for feature, value, spread in zip(features, values, spreads, strict=True):
                row = curves.setdefault(
                    (feature, roi), {"feature": feature, "region": label(roi), "number": [], "mean": [], "sd": []}
                )
                for name, one in (("number", number), ("mean", _short(float(value))), ("sd", _short(float(spread)))):
                    row[name].append(one)
    return {"curves": list(curves.values()), "settings": settings}


def _chains(pairs: Sequence[Mapping]) -> dict[str, list[dict]]:
    """Return {kind: [{key: setting}]} of settings that pairs of this kind connect; of repeats, all settings."""
    found: dict[str, list[dict]] = {}
    for pair in pairs:
        chains = found.setdefault(pair["kind"], [])
        ends = {setting_key(pair[end]): pair[end] for end in ("first", "second")}
        joined = [chain for chain in chains if chain.keys() & ends.keys() or pair["relation"] == "repeats"]
        chains[:] = [chain for chain in chains if all(chain is not one for one in joined)]
        chains.append({key: setting for chain in [*joined, ends] for key, setting in chain.items()})
    return found


def save(specification: Mapping, paths: Iterable[str | Path]) -> None:
    """Write a specification as .png (200 dpi) and .pdf; all files are complete before the first is moved to its path.

    Raises
    ------
    ValueError
        For other suffixes.
    """
    with contextlib.ExitStack() as stack:
        for path in map(Path, paths):
            if path.suffix == ".png":
                content = vl_convert.vegalite_to_png(specification, vl_version=VEGA_LITE, ppi=style.DOTS_PER_INCH)
            elif path.suffix == ".pdf":
                content = vl_convert.vegalite_to_pdf(specification, vl_version=VEGA_LITE)
            else:
                raise ValueError(f"{path}: figures are written as .png or .pdf")
            stack.enter_context(replacing(path, checksum=False)).write_bytes(content)


def bundle() -> str:
    """Return the JavaScript of Vega, Vega-Lite and Vega-Embed (BSD 3-clause) for a page without a network.

    The user's cache keeps it, because vl-convert takes a second to make it.
    """
    base = user_cache() or temporary_cache() or Path(os.devnull)  # in which no file can exist
    cached = base / f"vega-lite-{VEGA_LITE}-vl-convert-{version('vl-convert-python')}.js"
    with contextlib.suppress(Exception):  # a missing or broken file is made again
        check_unchanged(cached)
        return cached.read_bytes().decode()
    # End tags in texts of the libraries would end the page's own elements.
    script = re.sub(r"</(?=(?:body|head|html|script)\b)", r"<\\/", vl_convert.javascript_bundle(vl_version=VEGA_LITE))
    # Without write access the cache is skipped.
    with contextlib.suppress(OSError, InputError), replacing(cached) as temporary:
        temporary.write_bytes(script.encode())
    return script
