"""Seals: published hashes bind each truth before the diagnosis and each verdict before the score.

The digest of a truth is the SHA-256 of its salt, followed by the truth as canonical JSON. Canonical JSON has sorted
keys, no spaces, and the shortest text of a float that reads back to the same number. Without the salt, the few possible
truths could be guessed from the digest.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from ...base.errors import InputError
from ...io.files import check_unchanged, write_text

SALT = re.compile(r"[0-9a-f]{64}")


def canonical(truth: Mapping) -> str:
    """Return the canonical JSON of a truth.

    Raises
    ------
    ValueError
        For values that JSON cannot represent, such as NaN and infinity.
    """
    return json.dumps(truth, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def sealed(truth: Mapping, salt: str) -> dict:
    """Return the sealed document of a truth, {"case", "salt", "truth"}. The truth has the key `case`.

    Parameters
    ----------
    salt : str
        64 hexadecimal digits, drawn for this case alone.

    Raises
    ------
    ValueError
        If the salt has another form.
    """
    if not SALT.fullmatch(salt):
        raise ValueError("a salt is 64 hexadecimal digits in lower case")
    truth = json.loads(canonical(truth))
    return {"case": truth["case"], "salt": salt, "truth": truth}


def digest(document: Mapping) -> str:
    """Return the SHA-256 of a sealed document, hexadecimal."""
    return hashlib.sha256((document["salt"] + canonical(document["truth"])).encode("ascii")).hexdigest()


def publish(documents: Iterable[Mapping]) -> dict[str, str]:
    """Return {case: digest} of sealed documents, which is published before any recording is made.

    Raises
    ------
    ValueError
        If a case occurs twice.
    """
    seals: dict[str, str] = {}
    for document in documents:
        if document["case"] in seals:
            raise ValueError(f"{document['case']} is sealed twice")
        seals[document["case"]] = digest(document)
    return dict(sorted(seals.items()))


def files_of(diagnosis: str | Path, other: str | Path | None = None) -> dict[str, str]:
    """Return the SHA-256 of a diagnosis, and of a table of agreement `other`, before the seal is opened.

    Raises
    ------
    InputError
        If a file is missing or was changed after it was written.
    """
    for _, path in _bound(diagnosis, other):
        check_unchanged(path, "diagnose it again")
    return {key: hashlib.sha256(_bytes(path)).hexdigest() for key, path in _bound(diagnosis, other)}


def _bound(diagnosis: str | Path, other: str | Path | None) -> list[tuple[str, str | Path]]:
    """List the files that a verdict binds, with their keys."""
    files = [("diagnosis_sha256", diagnosis), ("held_out_protocol_sha256", other)]
    return [(key, path) for key, path in files if path is not None]


def write(document: Mapping, path: str | Path) -> None:
    """Write a sealed document, the published seals or a verdict."""
    write_text(json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n", path)


def read(path: str | Path) -> dict:
    """Read a document that `write` has written.

    Raises
    ------
    InputError
        If the file is missing or not a JSON object.
    """
    return _object(_bytes(path), path)


def open_seal(path: str | Path, seals: Mapping[str, str]) -> dict:
    """Return the truth of a sealed document after a check against the published digests, {case: digest}.

    Raises
    ------
    InputError
        If the document is broken, its case differs from the file's name or was not published, or truth or salt were
        changed.
    """
    document = read(path)
    try:
        case, truth = document["case"], document["truth"]
        found = digest(document)
        same = truth["case"] == case
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is not a sealed truth ({error!r}); make the suite again") from None
    if case != Path(path).stem:
        raise InputError(f"{path}: contains case {case}; restore the original names of the sealed files")
    if case not in seals:
        raise InputError(f"{path}: {case} is not among the published seals; use only published cases")
    if not same or found != seals[case]:
        raise InputError(
            f"{path}: the truth or the salt of {case} was changed after the seal was published (SHA-256 "
            f"{found[:12]}..., published {seals[case][:12]}...); restore the file or make the suite again"
        )
    return truth


def check_verdict(case: str, diagnosis: str | Path, bound: Mapping, other: str | Path | None = None) -> dict:
    """Return the diagnosis after a check, with a table of agreement `other`, against the digests of its verdict.

    Raises
    ------
    InputError
        If a file was changed, added or removed, or is broken.
    """
    given = dict(_bound(diagnosis, other))
    if set(given) != set(bound):
        raise InputError(f"{case}.json: the verdict does not match the present files of {case}; diagnose it again")
    contents = {key: _bytes(path) for key, path in given.items()}
    for key, content in contents.items():
        if hashlib.sha256(content).hexdigest() != bound[key]:
            raise InputError(
                f"{given[key]}: was changed after its verdict was written; restore the file or diagnose {case} again"
            )
    return _object(contents["diagnosis_sha256"], diagnosis)


def _bytes(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _object(content: bytes, path: str | Path) -> dict:
    try:
        found = json.loads(content)
    except ValueError as error:
        raise InputError(f"{path}: is not valid JSON ({' '.join(str(error).split())})") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: is not a JSON object")
    return found
