"""Where the files lie that come with the library: JSON schemas, and tables of measurements, layouts and costs."""

from pathlib import Path

import yaml

_PACKAGE = Path(__file__).resolve().parents[1]
SCHEMAS = _PACKAGE / "schemas"
RESOURCES = _PACKAGE / "resources"
DEFAULT_STUDY = _PACKAGE.parents[2] / "config" / "config.yaml"  # of the clone; a package that was built has none


# libyaml, where PyYAML has it, reads ten times as fast. Its messages are others: what users write is read without it.
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def shipped_yaml(path: Path) -> dict:
    """A YAML file that comes with the library."""
    loader = _LOADER(path.read_text(encoding="utf-8"))
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()
