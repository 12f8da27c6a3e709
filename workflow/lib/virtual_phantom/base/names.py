"""Display names of effects, protocols and ROIs for text, tables and figures."""

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
    "centre": "center",
    "isocentre": "isocenter",
    "grey": "gray",
    "neighbours": "neighbors",
}


def label(name: object) -> str:
    """Return a name for display: underscores become spaces, and words of WRITTEN get their usual American form."""
    words = str(name).replace("_", " ").split()
    return " ".join(WRITTEN.get(word, word) for word in words)


def counted(number: int, thing: str) -> str:
    """Return a number with its noun: 1 repeat, 2 repeats."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def same_but_for_case(names: Iterable[str]) -> tuple[str, str] | None:
    """Return the first two names that differ only in case; None if there are none.

    On a file system that ignores case, such as the file system of macOS, files with these names would be one file.
    """
    seen: dict[str, str] = {}
    for name in names:
        if (other := seen.setdefault(name.casefold(), name)) != name:
            return other, name
    return None


def enumerated(phrases: Sequence[str]) -> str:
    """Join phrases with commas, the last with "and"."""
    return " and ".join([", ".join(phrases[:-1]), phrases[-1]] if len(phrases) > 1 else phrases)
