"""Open the seals of a suite, and read the verdicts on its cases."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from ...base.errors import InputError
from ...diagnosis.verdict_text import PRACTICAL, SETUP_VERDICTS, VERDICTS
from ..hiding import seal
from ..hiding.case import Case, checked
from .verdicts import read_verdicts, verdict_document

# Keys of a diagnosis that are scored or shown.
SCORED = (
    *("recording", "verdict", "sentence", "locations", "effects", "ambiguous_with", "ruled_out"),
    *("excess_rms_removed", "remainder_sd"),
)


def opened(sealed: Iterable[str | Path], seals: str | Path) -> dict[str, dict]:
    """Open every seal and return {case: truth}.

    Raises
    ------
    InputError
        If a file was changed or is missing (every published case counts).
    """
    published = seal.read(seals)
    truths = {}
    for path in sealed:
        truth = checked(seal.open_seal(path, published), path)
        truths[truth["case"]] = truth
    for case in published:
        if case not in truths:
            raise InputError(f"{seals}: {case} was published but has no sealed truth; run the missing jobs")
    return dict(sorted(truths.items()))


def collect_verdicts(sealed: Iterable[str | Path], seals: str | Path, verdicts: Mapping[str, dict]) -> list[Case]:
    """Return the cases of a suite with the verdicts of any program, {case: verdict document}."""
    return [Case(truth, verdicts[case]) for case, truth in opened(sealed, seals).items()]


def collect(
    sealed: Iterable[str | Path],
    seals: str | Path,
    verdicts: Iterable[str | Path],
    diagnoses: Iterable[str | Path],
    others: Iterable[str | Path] = (),
) -> list[Case]:
    """Open every seal and check every diagnosis against its verdict.

    Parameters
    ----------
    seals : str or Path
        File of the published seals.
    diagnoses, others : iterable of str or Path
        Files in one folder per case, which has the name of the case. `others` are tables of agreement on another
        protocol.

    Returns
    -------
    list of Case
        Sorted by name.

    Raises
    ------
    InputError
        If a file was changed, is missing (every published case counts) or has invalid content.
    """
    bound = read_verdicts(verdicts, seal.read(seals))
    truths = opened(sealed, seals)
    diagnosed = {Path(path).parent.name: path for path in diagnoses}
    tables = {Path(path).parent.name: path for path in others}
    found = []
    for case, truth in truths.items():
        if case not in diagnosed:
            raise InputError(f"{seals}: {case} was published but has no diagnosis; run the missing jobs")
        content = seal.check_verdict(case, diagnosed[case], bound[case].get("files", {}), tables.get(case))
        diagnosis = complete(content, diagnosed[case], case)
        verdict = verdict_document(diagnosis)
        if verdict != {key: value for key, value in bound[case].items() if key != "files"}:
            raise InputError(f"{case}.json: the verdict differs from {diagnosed[case]}; diagnose {case} again")
        found.append(Case(truth, verdict, diagnosis, metrics(tables[case]) if case in tables else None))
    return found


def complete(diagnosis: dict, source: str | Path, recording: str | None = None) -> dict:
    """Return the diagnosis if it has every scored key and belongs to the recording.

    Parameters
    ----------
    source : str or Path
        File that an error message names.
    recording : str, optional
        None accepts any recording.

    Raises
    ------
    InputError
        If a key is missing or the recording is another one.
    """
    missing = [key for key in SCORED if key not in diagnosis]
    if missing or diagnosis["verdict"] not in (*VERDICTS, PRACTICAL, *SETUP_VERDICTS.values()):
        what = f"it has no {', '.join(missing)}" if missing else f"verdict {diagnosis['verdict']!r}"
        raise InputError(f"{source}: is not a diagnosis that can be scored ({what}); diagnose the case again")
    if recording not in (None, diagnosis["recording"]):
        raise InputError(f"{source}: is the diagnosis of {diagnosis['recording']!r}; diagnose {recording} again")
    return diagnosis


def metrics(path: str | Path) -> dict:
    """Read the metrics of a table of agreement.

    Raises
    ------
    InputError
        If the file is broken.
    """
    content = seal.read(path)
    found = content.get("metrics")
    if not isinstance(found, Mapping):
        raise InputError(f"{path}: has no metrics; is this a table of agreement?")
    for name, entry in found.items():
        if not isinstance(entry, Mapping) or not {"before", "after", "floor"} <= set(entry):
            raise InputError(f"{path}: {name} has no before, after and floor; is this a table of agreement?")
    return found
