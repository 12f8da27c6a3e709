"""Seals: a truth is bound by a published salted SHA-256 before it is tested, a verdict by its own before it is scored.

The digest of a truth is SHA-256 of its salt followed by the canonical JSON of the truth: sorted keys, no spaces, floats
as the shortest text that reads back to the same number. Without the salt, the few possible truths could be tried.
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
    """The one text of a truth.

    Raises
    ------
    ValueError
        For what JSON cannot hold, NaN and infinity among it.
    """
    return json.dumps(truth, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def sealed(truth: Mapping, salt: str) -> dict:
    """The document that is kept shut.

    Parameters
    ----------
    truth : mapping
        With its `case`.
    salt : str
        64 hexadecimal digits, drawn for this case alone.

    Returns
    -------
    dict
        {"case", "salt", "truth"}.

    Raises
    ------
    ValueError
        For another salt.
    """
    if not SALT.fullmatch(salt):
        raise ValueError("a salt is 64 hexadecimal digits in lower case")
    truth = json.loads(canonical(truth))
    return {"case": truth["case"], "salt": salt, "truth": truth}


def digest(document: Mapping) -> str:
    """SHA-256 of a sealed document, hexadecimal."""
    return hashlib.sha256((document["salt"] + canonical(document["truth"])).encode("ascii")).hexdigest()


def publish(documents: Iterable[Mapping]) -> dict[str, str]:
    """What is published before any recording is made.

    Parameters
    ----------
    documents : iterable of mapping
        From `sealed`.

    Returns
    -------
    dict of str to str
        {case: digest}.

    Raises
    ------
    ValueError
        For a case that comes twice.
    """
    seals: dict[str, str] = {}
    for document in documents:
        if document["case"] in seals:
            raise ValueError(f"{document['case']} is sealed twice")
        seals[document["case"]] = digest(document)
    return dict(sorted(seals.items()))


def verdict_of(case: str, diagnosis: str | Path, other: str | Path | None = None) -> dict[str, str]:
    """The document that binds a diagnosis before its seal is opened.

    Parameters
    ----------
    diagnosis : str or Path
        Of the case.
    other : str or Path, optional
        Its table of agreement by another protocol, if there is one, which is bound too.

    Raises
    ------
    InputError
        If there is no such file, or it was changed since it was written.
    """
    for _, path in _bound(diagnosis, other):
        check_unchanged(path, "diagnose it again")
    return {"case": case} | {key: hashlib.sha256(_bytes(path)).hexdigest() for key, path in _bound(diagnosis, other)}


def _bound(diagnosis: str | Path, other: str | Path | None) -> list[tuple[str, str | Path]]:
    """The files that a verdict binds, by their keys in it."""
    files = [("diagnosis_sha256", diagnosis), ("held_out_protocol_sha256", other)]
    return [(key, path) for key, path in files if path is not None]


def write(document: Mapping, path: str | Path) -> None:
    """Write a sealed document, the published seals or a verdict."""
    write_text(json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n", path)


def read(path: str | Path) -> dict:
    """Read what `write` wrote.

    Raises
    ------
    InputError
        If it is missing or no JSON object.
    """
    return _object(_bytes(path), path)


def open_seal(path: str | Path, seals: Mapping[str, str]) -> dict:
    """The truth of a sealed document, checked against the published digests.

    Parameters
    ----------
    seals : mapping of str to str
        {case: digest}.

    Raises
    ------
    InputError
        If the document is broken, of another case than its file's name, its case was not published, or truth or salt
        are not those published.
    """
    document = read(path)
    try:
        case, truth = document["case"], document["truth"]
        found = digest(document)
        same = truth["case"] == case
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is no sealed truth ({error!r}); make the suite again") from None
    if case != Path(path).stem:
        raise InputError(f"{path}: holds the truth of {case}; put every sealed file back in its place")
    if case not in seals:
        raise InputError(f"{path}: {case} is not among the published seals; only what was published before counts")
    if not same or found != seals[case]:
        raise InputError(
            f"{path}: truth or salt of {case} were changed after the seal was published (SHA-256 {found[:12]}..., "
            f"published {seals[case][:12]}...); restore the file or make the suite again"
        )
    return truth


def check_verdict(diagnosis: str | Path, verdict: str | Path, other: str | Path | None = None) -> dict:
    """The diagnosis, checked against the digests that were taken before the seal was opened.

    Parameters
    ----------
    other : str or Path, optional
        Its table by another protocol, which is checked too.

    Raises
    ------
    InputError
        If one was changed since, came or went, or if a file is broken.
    """
    bound = read(verdict)
    if "diagnosis_sha256" not in bound or "case" not in bound:
        raise InputError(f"{verdict}: is no verdict; diagnose the case again")
    given = dict(_bound(diagnosis, other))
    if set(given) != set(bound) - {"case"}:
        raise InputError(f"{verdict}: is not of the files that {bound['case']} has now; diagnose it again")
    contents = {key: _bytes(path) for key, path in given.items()}
    for key, content in contents.items():
        if hashlib.sha256(content).hexdigest() != bound[key]:
            raise InputError(
                f"{given[key]}: was changed after its verdict was given ({verdict}); restore the file or diagnose "
                f"{bound['case']} again"
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
        raise InputError(f"{path}: is no JSON ({' '.join(str(error).split())})") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: is no JSON object")
    return found
