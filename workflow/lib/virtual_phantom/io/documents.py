"""JSON documents with a schema, validated when they are written and read."""

from __future__ import annotations

import json
from pathlib import Path

from ..base.data import SCHEMAS
from ..base.errors import InputError, refusing
from .files import read_text, write_text
from .schema import read_schema, validate

# Names of files NAME.schema.yaml in SCHEMAS
DIAGNOSIS, SCORE, SCANNER, IMAGE_QUALITY = "diagnosis", "score", "scanner", "image_quality"
VERDICT, PROGRAM_SCORE = "verdict", "program_score"


def write_document(content: dict, path: str | Path, kind: str) -> None:
    """Write a document of one of the kinds above.

    Raises
    ------
    InputError
        If the schema refuses the content; nothing is written.
    """
    validate(content, schema_of_kind(kind), f"{kind}.json")
    write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", path)


def read_document(path: str | Path, kind: str, advice: str = "make it again") -> dict:
    """Read a document of one of the kinds above.

    Raises
    ------
    InputError
        If the file is missing, not JSON, or refused by the schema.
    """
    with refusing(f"{path}: is no {kind}.json", OSError, ValueError, advice=advice):
        content = json.loads(read_text(path))
    try:
        validate(content, schema_of_kind(kind), f"{kind}.json")
    except InputError as error:
        raise InputError(f"{path}: is no {kind}.json ({error}); {advice}") from error
    return content


def schema_of_kind(kind: str) -> dict:
    """Return the schema of a kind of document."""
    return read_schema(SCHEMAS / f"{kind}.schema.yaml")
