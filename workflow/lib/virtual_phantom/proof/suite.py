"""Which cases a suite has, and what is concealed in each: drawn from the suite's seed alone."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ..errors import InputError
from .catalogue import CATALOGUE, STRENGTHS
from .objects import OBJECTS

PHANTOMS = tuple(OBJECTS)
TRUTH, SALT, SCAN = range(3)  # branches of a case's seed
KNOWN = tuple(name for name, one in CATALOGUE.items() if one.known)
UNKNOWN = tuple(name for name, one in CATALOGUE.items() if not one.known)


def cases(settings: Mapping) -> list[str]:
    """Names of all cases, which tell nothing of what is concealed."""
    return [f"case_{number:02d}" for number in range(1, 1 + len(_plan(settings)))]


def phantom_of(case: str) -> str:
    """What is scanned in a case: no secret, and told by its number alone."""
    return PHANTOMS[int(case.rpartition("_")[2]) % len(PHANTOMS)]


def check_recordings(names: Sequence[str], diagnosed: Collection[str]) -> None:
    """Raise InputError for names that are not under `diagnosis.recordings`, or are like those of cases."""
    for name in names:
        if re.fullmatch(r"case_[0-9]+", name):
            raise InputError(f"proof.recordings: '{name}' is the name of a case; give the recording another one")
        if name not in diagnosed:
            known = ", ".join(diagnosed) or "none"
            raise InputError(f"proof.recordings: '{name}' is not under diagnosis.recordings ({known}); add it there")


def truths(settings: Mapping) -> dict[str, dict]:
    """{case: truth}, as seal.sealed takes them.

    settings   the section `proof` of the configuration: seed, effects, strengths, and how many cases of nothing, of
               pairs and of unknown effects
    """
    plan = _plan(settings)
    order = np.random.default_rng(_branch(settings["seed"], 0)).permutation(len(plan))
    return {
        case: _truth(case, *plan[order[number]], settings["seed"], number)
        for number, case in enumerate(cases(settings))
    }


def salt(seed: int, number: int) -> str:
    """64 hexadecimal digits of a case of its own."""
    words = _branch(seed, 1, number, SALT).generate_state(8)
    return "".join(f"{word:08x}" for word in words)


def scan_seed(seed: int, number: int) -> np.random.SeedSequence:
    """Of the noise of a case's scans."""
    return _branch(seed, 1, number, SCAN)


def _branch(seed: int, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=key)


def _plan(settings: Mapping) -> list[tuple[str, str | None, str | None]]:
    """(category, strength, effect): effects of pairs and unknown ones are drawn later."""
    effects = settings.get("effects") or list(KNOWN)
    for name in effects:
        if name not in KNOWN:
            raise InputError(f"proof.effects: '{name}' cannot be concealed; use some of {', '.join(KNOWN)}")
    plan = [("single", strength, name) for name in effects for strength in settings["strengths"]]
    plan += [("none", None, None)] * settings["none"]
    plan += [("pair", None, None)] * settings["pairs"]
    plan += [("unknown", None, UNKNOWN[number % len(UNKNOWN)]) for number in range(settings["unknown"])]
    return plan


def _truth(case, category, strength, effect, seed, number) -> dict:
    random = np.random.default_rng(_branch(seed, 1, number, TRUTH))
    names = [] if effect is None else [effect]
    if category == "pair":
        names = _pair(random)
    drawn = []
    for name in names:
        # Of pairs and unknown effects no weak ones: what cannot be seen cannot be told apart.
        size = strength or str(random.choice(STRENGTHS[1:]))
        made, comparable = CATALOGUE[name].draw(size, random)
        drawn.append(
            {
                "name": name,
                "known": CATALOGUE[name].known,
                "strength": size,
                "settings": made,
                "comparable": comparable,
            }
        )
    return {
        "case": case,
        "number": number,
        "kind": "projections",
        "phantom": phantom_of(case),
        "category": category,
        "strength": strength or (drawn[0]["strength"] if category == "unknown" else None),
        "effects": drawn,
        "where": sorted({domain for name in names for domain in CATALOGUE[name].where}),
    }


def _pair(random: np.random.Generator) -> list[str]:
    """Two effects of different groups, in the order of the catalogue."""
    while True:
        first, second = sorted(random.choice(len(KNOWN), 2, replace=False))
        groups = [CATALOGUE[KNOWN[index]].alike for index in (first, second)]
        if not groups[0] or groups[0] != groups[1]:
            return [KNOWN[first], KNOWN[second]]
