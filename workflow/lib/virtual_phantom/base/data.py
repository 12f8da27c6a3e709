"""Where the files lie that come with the library: JSON schemas, and tables of measurements, layouts and costs."""

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
    """The clone that the library comes from.

    Returns
    -------
    Path or None
        The folder around the library, or the one that pip installed it from (PEP 610). None for a library without its
        workflow.
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


# libyaml, where PyYAML has it, reads ten times as fast. Its messages are others: what users write is read without it.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def shipped_yaml(path: Path) -> dict:
    """A YAML file that comes with the library."""
    loader = _LOADER(path.read_text(encoding="utf-8"))
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()
