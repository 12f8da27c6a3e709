"""Report of a study (report.html): one file with figures, sortable tables and provenance.

Captions are the reStructuredText templates of Snakemake's report (workflow/report).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from platform import python_version
from types import SimpleNamespace

import pandas as pd
import yaml
from docutils.core import publish_parts
from jinja2 import Environment, StrictUndefined

from .. import __version__
from ..features.names import is_feature
from ..figures import style
from ..io.files import read_csv, sha256
from ..statistics.trust import percent
from .answer import TITLES, robustness_answer
from .html import data_url, number, render
from .methods import how_to_report

PACKAGES = (  # packages that results depend on
    *("snakemake", "numpy", "scipy", "numba", "pandas", "pyradiomics", "SimpleITK", "nibabel", "scikit-learn"),
    *("scikit-image", "xraylib", "spekpy", "matplotlib"),
)
MOST_ROWS = 1000  # longer tables are linked but not shown
TRUST = "trust"  # table with a row per feature and change, of which the report shows the use of each feature


@dataclass(frozen=True)
class ReportFigure:
    """Figure of a report.

    Attributes
    ----------
    path : Path
        PNG file.
    caption : Path
        Template of the caption.
    params, wildcards : mapping
        Parameters and wildcards of the Snakemake rule, for the template.
    """

    path: Path
    section: str
    title: str
    caption: Path
    params: Mapping
    wildcards: Mapping


def report_figures(
    pictures: Sequence[str | Path], captions: Sequence[str | Path], params: Sequence[Mapping]
) -> list[ReportFigure]:
    """Return report figures; each mapping in `params` has the section, title, params and wildcards of one figure."""
    return [
        ReportFigure(Path(picture), caption=Path(caption), **fields)
        for picture, caption, fields in zip(pictures, captions, params, strict=True)
    ]


def report_page(
    figures: Sequence[ReportFigure],
    tables: Mapping[str, Path],
    embedded: Mapping[str, Path],
    links: Mapping[str, str],
    config: Mapping,
) -> str:
    """Render the page as HTML.

    Parameters
    ----------
    tables : mapping of str to Path
        {title: CSV file}.
    embedded : mapping of str to Path
        {title: page} of reports of diagnoses, which are embedded.
    links : mapping of str to str
        {title: address} of related pages.
    """
    sections: dict[str, list] = {}
    for figure in figures:
        sections.setdefault(figure.section, []).append(
            {
                "name": figure.path.stem,
                "title": figure.title,
                "picture": data_url(figure.path.read_bytes()),
                "caption": caption(figure, config),
            }
        )
    frames = {title: read_csv(path) for title, path in tables.items()}
    return render_study(
        "study",
        config,
        sections=sections,
        tables=[
            {"title": title, "name": tables[title].stem, "frame": frame}
            | {"shown": tables[title].stem != TRUST and len(frame) <= MOST_ROWS}
            for title, frame in frames.items()
        ],
        counts=_uses(frames, tables),
        TITLES=TITLES,
        embedded={title: path.read_text(encoding="utf-8") for title, path in embedded.items()},
        links=links,
        checksums={str(path): sha256(path) for path in tables.values()},
    )


def _uses(frames: Mapping[str, pd.DataFrame], tables: Mapping[str, Path]) -> dict[str, list[tuple[str, str]]]:
    """Return {use: [(feature, reason)]}; none without the table, or for a single region."""
    found = [frame for title, frame in frames.items() if tables[title].stem == TRUST and frame["rois"].iloc[0] > 1]
    return robustness_answer(found[0])["uses"] if found else {}


def render_study(template: str, config: Mapping, **values) -> str:
    """Render a page of a study with its complete configuration and the versions of the packages."""
    versions = packages()
    return render(
        template,
        {"cell": cell, "percent": percent},
        methods=how_to_report(config, versions, __version__),
        trial=config["trial"],
        TRIAL=style.TRIAL,
        config=yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True),
        packages=versions,
        **values,
    )


def packages() -> dict[str, str]:
    """Return {name: installed version} of Python and PACKAGES."""
    return {"Python": python_version()} | {name: metadata.version(name) for name in PACKAGES}


def caption(figure: ReportFigure, config: Mapping) -> str:
    """Render a figure's caption as HTML."""
    names = SimpleNamespace(
        params=SimpleNamespace(**figure.params), wildcards=SimpleNamespace(**figure.wildcards), config=config
    )
    template = Environment(undefined=StrictUndefined).from_string(figure.caption.read_text(encoding="utf-8"))
    # Names from a configuration are untrusted: directives must not include files or raw HTML.
    settings = {"file_insertion_enabled": False, "raw_enabled": False, "_disable_config": True, "report_level": 3}
    return publish_parts(template.render(snakemake=names), writer="html5", settings_overrides=settings)["body"]


def cell(value: str | float) -> dict:
    """Return the text of a table cell, its sort key, and whether it is a number (n)."""
    if isinstance(value, str):
        return {"text": style.feature_label(value) if is_feature(value) else value, "key": value, "n": False}
    if pd.isna(value):
        return {"text": "", "key": "", "n": True}
    integer = float(value).is_integer()
    return {"text": str(int(value)) if integer else number(value), "key": repr(float(value)), "n": True}
