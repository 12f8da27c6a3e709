"""Verdict documents: what a program says about each case of a suite (schemas/verdict.schema.yaml)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from ...base.errors import InputError, InputErrors, did_you_mean
from ...diagnosis.verdict_text import SETUP_VERDICTS
from ...io.documents import VERDICT, read_document
from ...io.files import sha256
from ...physics.effect import names
from ..hiding.case import ADMITTED, MATCHES
from ..hiding.catalogue import CATALOGUE


def named_groups(diagnosis: Mapping) -> list[list[str]]:
    """Return the named effects of diagnosis.json in the order of rank, each followed by those that explain as much."""
    equal = diagnosis["ambiguous_with"]
    return [[effect["name"], *equal.get(effect["name"], ())] for effect in diagnosis["effects"]]


def verdict_document(diagnosis: Mapping) -> dict:
    """Return the verdict document of the content of diagnosis.json."""
    return {
        "case": diagnosis["recording"],
        "effects": named_groups(diagnosis),
        "unexplained": diagnosis["verdict"] in ADMITTED,
        "match": diagnosis["verdict"] in MATCHES,
        "other_object": diagnosis["verdict"] == SETUP_VERDICTS["object"],
        "parameters": {
            effect["name"]: {
                name: {"value": parameter["value"], "ci95": list(parameter["ci95"])}
                for name, parameter in effect["parameters"].items()
            }
            for effect in diagnosis["effects"]
        },
    }


def read_verdicts(paths: Iterable[str | Path], cases: Collection[str]) -> dict[str, dict]:
    """Return {case: verdict document} of files CASE.json, exactly one for each case.

    Raises
    ------
    InputErrors
        One line for each file that is missing, superfluous or invalid.
    """
    files = {Path(path).stem: path for path in paths}
    found, lines = {}, []
    for case in sorted({*cases, *files}):
        if case not in files:
            lines.append(f"{case}.json: is missing; every case of the suite needs a verdict")
        elif case not in cases:
            lines.append(f"{files[case]}: the suite has no {case}; delete the file")
        else:
            try:
                found[case] = _read(files[case])
            except InputError as error:
                lines.append(str(error))
    if lines:
        raise InputErrors(lines)
    return found


def _read(path: str | Path) -> dict:
    document = read_document(path, VERDICT, "correct it")
    if document["case"] != Path(path).stem:
        raise InputError(f"{path}: case is {document['case']!r}; use the name of the file")
    known = {*names(), *CATALOGUE}
    for group in document["effects"]:
        for name in group:
            if name not in known:
                raise InputError(f"{path}: there is no effect {name!r}; {did_you_mean(name, sorted(known))}")
    return document


def digests(paths: Iterable[str | Path]) -> dict[str, str]:
    """Return {case: SHA-256} of verdict files, which is written before the seals are opened."""
    return {Path(path).stem: sha256(path) for path in sorted(map(Path, paths))}
