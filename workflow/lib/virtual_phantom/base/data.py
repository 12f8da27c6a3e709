"""Where the files lie that come with the library: JSON schemas, and tables of measurements, layouts and costs."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
SCHEMAS = _PACKAGE / "schemas"
RESOURCES = _PACKAGE / "resources"
