"""Paths of the package's data files: JSON schemas, and tables of measurements, layouts and costs."""

import json
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from urllib.parse import unquote, urlparse

import yaml

_PACKAGE = Path(__file__).resolve().parents[1]
SCHEMAS = _PACKAGE / "schemas"
RESOURCES = _PACKAGE / "resources"


@cache
def clone() -> Path | None:
    """Return the repository that contains the library; None for a library without its workflow.

    This is the folder around the library, or the folder that pip installed it from (PEP 610).
    """
    places = [_PACKAGE.parents[2]]
    try:
        found = distribution("virtual-phantom").read_text("direct_url.json")
        url = urlparse(json.loads(found)["url"]) if found else None
    except (PackageNotFoundError, ValueError, KeyError):
        url = None
    if url is not None and url.scheme == "file":
        places.append(Path(unquote(url.path)))
    return next((place for place in places if (place / "workflow" / "Snakefile").is_file()), None)


# PyYAML's optional loader of libyaml is ten times as fast. Files of users are read without it: its messages differ.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def shipped_yaml(path: Path) -> dict:
    """Read a YAML file of the package."""
    loader = _LOADER(path.read_text(encoding="utf-8"))
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()
