"""How names of the configuration are read: of effects, protocols and ROIs, in sentences, tables and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

WRITTEN = {
    "sirt": "SIRT",
    "fbp": "FBP",
    "fdk": "FDK",
    "ct": "CT",
    "hu": "HU",
    "xray": "X-ray",
    "roi": "ROI",
    "rms": "RMS",
    "mgy": "mGy",
    "kvp": "kVp",
}


def label(name: object) -> str:
    """A name as it is read: underscores are spaces, words of WRITTEN are as there."""
    words = str(name).replace("_", " ").split()
    return " ".join(WRITTEN.get(word, word) for word in words)


def counted(number: int, thing: str) -> str:
    """So many things, in words: 1 repeat, 2 repeats."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def same_but_for_case(names: Iterable[str]) -> tuple[str, str] | None:
    """Return the first two names that differ only in case.

    Files named after them would be one file on a file system that ignores case, such as that of macOS.

    Returns
    -------
    tuple of str or None
        None if there are no such names.
    """
    seen: dict[str, str] = {}
    for name in names:
        if (other := seen.setdefault(name.casefold(), name)) != name:
            return other, name
    return None


def enumerated(phrases: Sequence[str]) -> str:
    """Phrases one after the other, the last with "and"."""
    return " and ".join([", ".join(phrases[:-1]), phrases[-1]] if len(phrases) > 1 else phrases)
