"""Where the files lie that come with the library: JSON schemas, and tables of measurements, layouts and costs."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
SCHEMAS = _PACKAGE / "schemas"
RESOURCES = _PACKAGE / "resources"
DEFAULT_STUDY = _PACKAGE.parents[2] / "config" / "config.yaml"  # of the clone; a package that was built has none
