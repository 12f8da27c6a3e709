"""Where the files lie that the library reads by itself: JSON schemas, and tables of measurements and layouts."""

from pathlib import Path

_PROJECT = Path(__file__).resolve().parents[4]
SCHEMAS = _PROJECT / "workflow" / "schemas"
RESOURCES = _PROJECT / "resources"
