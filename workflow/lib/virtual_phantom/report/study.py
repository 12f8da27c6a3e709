"""The report of a study: one HTML file with its figures, its tables and what they were made by.

Captions are those of Snakemake's own report (workflow/report): reStructuredText with the rule's parameters filled in.
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
from .html import data_url, number, render

# What results depend on.
PACKAGES = (
    *("snakemake", "numpy", "scipy", "numba", "pandas", "pyradiomics", "SimpleITK", "nibabel", "scikit-learn"),
    *("scikit-image", "xraylib", "spekpy", "matplotlib", "seaborn"),
)
MOST_ROWS = 1000  # longer tables are linked to


@dataclass(frozen=True)
class Shown:
    """A figure.

    Attributes
    ----------
    path : Path
        Its picture (PNG).
    caption : Path
        Its caption's template.
    params, wildcards : mapping
        What that names.
    """

    path: Path
    section: str
    title: str
    caption: Path
    params: Mapping
    wildcards: Mapping


def shown(pictures: Sequence[str | Path], captions: Sequence[str | Path], params: Sequence[Mapping]) -> list[Shown]:
    """Figures of their pictures, their captions' templates, and of each the rest that Shown has."""
    return [
        Shown(Path(picture), caption=Path(caption), **one)
        for picture, caption, one in zip(pictures, captions, params, strict=True)
    ]


def page(
    figures: Sequence[Shown],
    tables: Mapping[str, Path],
    embedded: Mapping[str, Path],
    links: Mapping[str, str],
    config: Mapping,
) -> str:
    """The page as HTML.

    Parameters
    ----------
    tables : mapping of str to Path
        CSV files by title, in the order in which they are shown.
    embedded : mapping of str to Path
        Pages (diagnoses) by title, to be shown inside.
    links : mapping of str to str
        Addresses beside the page by what they are called.
    config : mapping
        The complete configuration.
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
    filters = {"cell": cell}
    return render(
        "study",
        filters,
        sections=sections,
        tables=[
            {"title": title, "name": tables[title].stem, "frame": frame, "shown": len(frame) <= MOST_ROWS}
            for title, frame in frames.items()
        ],
        embedded={title: path.read_text(encoding="utf-8") for title, path in embedded.items()},
        links=links,
        trial=config["trial"],
        TRIAL=style.TRIAL,
        config=yaml.safe_dump(config, sort_keys=False, allow_unicode=True),
        version=__version__,
        packages=packages(),
        checksums={str(path): sha256(path) for path in tables.values()},
    )


def packages() -> dict[str, str]:
    """What results depend on, and the version of each that is installed; Python first."""
    return {"Python": python_version()} | {name: metadata.version(name) for name in PACKAGES}


def caption(figure: Shown, config: Mapping) -> str:
    """A figure's caption as HTML."""
    names = SimpleNamespace(
        params=SimpleNamespace(**figure.params), wildcards=SimpleNamespace(**figure.wildcards), config=config
    )
    template = Environment(undefined=StrictUndefined).from_string(figure.caption.read_text(encoding="utf-8"))
    # A config's names are data, not directives: files cannot be included, nor raw HTML.
    settings = {"file_insertion_enabled": False, "raw_enabled": False, "_disable_config": True, "report_level": 3}
    return publish_parts(template.render(snakemake=names), writer="html5", settings_overrides=settings)["body"]


def cell(value: str | float) -> dict:
    """How a value is written, what it is sorted by, and whether it is a number."""
    if isinstance(value, str):
        return {
            "text": style.feature_label(value) if is_feature(value) else value,
            "key": value,
            "n": False,
        }
    if pd.isna(value):
        return {"text": "", "key": "", "n": True}
    whole = float(value).is_integer()
    return {"text": str(int(value)) if whole else number(value), "key": repr(float(value)), "n": True}
