"""JSON documents that have a schema: checked when they are written, and when they are read."""

from __future__ import annotations

import json
from pathlib import Path

from ..base.data import SCHEMAS
from ..base.errors import InputError, refusing
from .files import read_text, write_text
from .schema import read_schema, validate

DIAGNOSIS, SCORE, SCANNER = "diagnosis", "score", "scanner"  # SCHEMAS holds NAME.schema.yaml


def write_document(content: dict, path: str | Path, kind: str) -> None:
    """Write a document of this kind, one of DIAGNOSIS, SCORE and SCANNER.

    Raises
    ------
    InputError
        If the schema refuses the content; then nothing is written.
    """
    validate(content, schema_of_kind(kind), f"{kind}.json")
    write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", path)


def read_document(path: str | Path, kind: str) -> dict:
    """Read a document of this kind, one of DIAGNOSIS, SCORE and SCANNER.

    Raises
    ------
    InputError
        If the file is missing, no JSON, or refused by the schema.
    """
    with refusing(f"{path}: is no {kind}.json", OSError, ValueError, advice="make it again"):
        content = json.loads(read_text(path))
    try:
        validate(content, schema_of_kind(kind), f"{kind}.json")
    except InputError as error:
        raise InputError(f"{path}: is no {kind}.json ({error}); make it again") from error
    return content


def schema_of_kind(kind: str) -> dict:
    """The schema of a kind of document."""
    return read_schema(SCHEMAS / f"{kind}.schema.yaml")
