"""Registration of a run before its scans: commit, scoring rule, seed, cases; and the log of runs.

A registered run takes its seed from the commit, so that neither can be chosen to fit the other, and a second run of a
commit gives the same result.
"""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from ...base.errors import InputError, refusing
from ...io.files import sha256
from ..hiding import seal
from .rule import RULE, VERSION

WORKFLOW = Path(__file__).resolve().parents[4]  # the rules, scripts and library
COMMIT = "commit"  # value of proof.seed
DIGITS = 8  # of the commit's hash in the seed
STARTS = REGISTERED, RESUMED = ("registered", "resumed")
EVENTS = (*STARTS, "failed", "scored")


@cache
def commit() -> str | None:
    """Return the commit of the code, or None if it is not in a Git repository."""
    tracked = _git("ls-files", "--error-unmatch", str(Path(__file__).resolve()))
    found = None if tracked is None else _git("rev-parse", "HEAD")
    return found and found.strip()


def changed_files() -> list[str]:
    """Return the files of rules, scripts and library that differ from the commit or are not part of it."""
    found = _git("status", "--porcelain", "--", ".", "../Snakefile")
    return [line[3:] for line in (found or "").splitlines()]


def _git(*arguments: str) -> str | None:
    """Return the output of Git, or None if it fails or is not installed."""
    try:
        done = subprocess.run(["git", *arguments], cwd=WORKFLOW, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout


def seed_of(stated: int | str) -> int:
    """Return the seed that proof.seed states: a number, or "commit" for one from the hash of the commit.

    Raises
    ------
    InputError
        If the code is not in a Git repository.
    """
    if stated != COMMIT:
        return int(stated)
    found = commit()
    if found is None:
        raise InputError("proof.seed: 'commit' needs a Git checkout of Virtual Phantom; use a whole number")
    return int(found[:DIGITS], 16)


def registration(settings: Mapping, truths: Iterable[Mapping], seals: str | Path) -> dict:
    """Return the registration of a run, which is written before its scans.

    Parameters
    ----------
    settings : mapping
        Section `proof` of the configuration, with the number of the seed, and settings of the diagnosis.
    truths : iterable of mapping
        Truths of the cases.
    seals : str or Path
        File of the published seals.

    Raises
    ------
    InputError
        If the seed comes from the commit and the code has changes that are not committed.
    """
    truths, changed = list(truths), changed_files()
    from_commit = commit() is not None and settings["seed"] == seed_of(COMMIT)
    if from_commit and changed:
        raise InputError(
            f"proof.seed: 'commit' needs code without changes, but {changed[0]} differs from the commit "
            f"(changed files: {len(changed)}); commit them, or use a whole number for a run that does not count"
        )
    return {
        "commit": commit(),
        "changed": changed,
        "rule": {"version": VERSION, "text": RULE},
        "seed": settings["seed"],
        "seed_from_commit": from_commit,
        "cases": len(truths),
        "simulators": sorted({truth["simulator"] for truth in truths}),
        "settings": _plain(settings),
        "seals_sha256": sha256(seals),
    }


def assessed(
    registered: Mapping, seals: str | Path, runs: str | Path, scored: Collection[str], settings: Mapping
) -> dict:
    """Return a registration with what is known when the run is scored.

    Parameters
    ----------
    seals, runs : str or Path
        File of the published seals, and log of runs.
    scored : collection of str
        Names of the cases that are scored.
    settings : mapping
        Settings of the score, as for `registration`.

    Returns
    -------
    dict
        The registration with starts (number, resumed ones included), `counts` (whether the run counts) and `reasons`
        (why not).

    Raises
    ------
    InputError
        If a file is broken.
    """
    left = registered["cases"] - len(seal.read(seals).keys() & set(scored))
    rows = _starts(runs, registered)
    starts = [row for row in rows if row["seals_sha256"] == registered["seals_sha256"]]
    reasons = [
        reason
        for reason, true in (
            ("its seed was chosen", not registered["seed_from_commit"]),
            ("the code had changes that were not committed", bool(registered["changed"] or changed_files())),
            ("the code changed after the registration", registered["commit"] != commit()),
            (
                "the scoring rule changed after the registration",
                registered["rule"] != {"version": VERSION, "text": RULE},
            ),
            ("the seals changed after the registration", registered["seals_sha256"] != sha256(seals)),
            ("the settings changed after the registration", registered["settings"] != _plain(settings)),
            (f"{left} of {registered['cases']} registered cases were not scored", left > 0),
            ("its start is not in the log of runs", REGISTERED not in [row["event"] for row in starts]),
            (
                "a start had another commit or changed code",
                any(row["changed"] or row["commit"] != registered["commit"] for row in starts),
            ),
            ("another suite was registered with this commit and seed", len(starts) < len(rows)),
        )
        if true
    ]
    return dict(registered) | {"starts": len(starts), "counts": not reasons, "reasons": reasons}


def _plain(settings: Mapping) -> dict:
    """Return settings as they are read from JSON."""
    return json.loads(json.dumps(settings))


def log_run(path: str | Path, event: str, registered: Mapping, done: int = 0) -> None:
    """Append an event, one of EVENTS, to the log of runs (JSON lines), with the commit and state of the present code.

    done: number of cases that have a diagnosis.
    """
    row = {"event": event, "time": datetime.now(UTC).isoformat(timespec="seconds"), "commit": commit()}
    row |= {key: registered[key] for key in ("seed", "cases", "seals_sha256")}
    row |= {"changed": len(changed_files()), "done": done}
    with Path(path).open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def attempts(path: str | Path, registered: Mapping) -> dict[str, int]:
    """Return how often each of EVENTS is in the log of runs for the suite of a registration.

    Raises
    ------
    InputError
        If the file is missing or broken.
    """
    seals = registered["seals_sha256"]
    counts = Counter(row["event"] for row in _logged(path) if row["seals_sha256"] == seals)
    return {event: counts[event] for event in EVENTS}


def _starts(path: str | Path, registered: Mapping) -> list[dict]:
    """Return the logged starts of a registration, and of other suites with its commit and seed."""
    rows = _logged(path) if Path(path).exists() else []
    commit_and_seed = {key: registered[key] for key in ("commit", "seed")}
    return [
        row
        for row in rows
        if row["event"] in STARTS
        and (row["seals_sha256"] == registered["seals_sha256"] or commit_and_seed.items() <= row.items())
    ]


def _logged(path: str | Path) -> list[dict]:
    with refusing(f"{path}: is not a log of runs", OSError, ValueError, TypeError, KeyError, advice="restore it"):
        rows = [json.loads(line) for line in Path(path).read_text(encoding="utf-8").splitlines()]
        # Logs of earlier versions lack `changed` and `seals_sha256`.
        return [
            {"changed": 0, "seals_sha256": None} | {key: row[key] for key in ("event", "seed", "commit")} | row
            for row in rows
        ]
