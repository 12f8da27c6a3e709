"""Cases of a suite and the effects hidden in each, drawn from the seed of the suite alone."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from ...base.errors import InputError
from ...base.proof_settings import ProofSettings
from ...base.streams import Stream, branch, generator
from .catalogue import CATALOGUE, IMAGE, STRENGTHS
from .missing_effects import MISSING_EFFECTS
from .objects import OBJECTS

PHANTOMS = tuple(OBJECTS)
KERNEL = "reconstruction_kernel"
LEAST_ROWS = 6  # needed for the slices of an image
PROTOCOLS = ("scan", "held_out_protocol")  # sections of the configuration
TRUTH, SALT, SCAN = range(3)  # branches of a case's seed
KNOWN = tuple(name for name, effect in CATALOGUE.items() if effect.known and not effect.of_images)
UNKNOWN = tuple(MISSING_EFFECTS)


def cases(settings: ProofSettings) -> list[str]:
    """List the names of all cases. A name does not reveal the hidden effects."""
    count = len(_plan(settings)) + len(_plan_of_images(settings))
    return [f"case_{number:02d}" for number in range(1, 1 + count)]


def kind_of(case: str, settings: ProofSettings) -> str:
    """Return the kind of the recording, which is no secret: images follow after all projections."""
    return "projections" if _number(case) <= len(_plan(settings)) else "images"


def phantom_of(case: str) -> str:
    """Return the phantom of a case, which is no secret: it follows from the case's number."""
    return PHANTOMS[_number(case) % len(PHANTOMS)]


def views_of(kind: str, settings: ProofSettings) -> tuple[int, int]:
    """Return the number of views for each of PROTOCOLS.

    Images have more views: with few views, streaks dominate, which differ between reconstructions.
    """
    times = settings.images.views_times if kind == "images" else 1
    return tuple(getattr(settings, protocol).views * times for protocol in PROTOCOLS)


def _number(case: str) -> int:
    return int(case.rpartition("_")[2])


def check_recordings(names: Sequence[str], diagnosed: Collection[str]) -> None:
    """Check the names of recordings that are shown next to the cases.

    Raises
    ------
    InputError
        If a name is not among `diagnosed` (names under `diagnosis.recordings`), or has the form of a case's name.
    """
    for name in names:
        if re.fullmatch(r"case_[0-9]+", name):
            raise InputError(f"proof.recordings: '{name}' is the name of a case; give the recording another one")
        if name not in diagnosed:
            known = ", ".join(diagnosed) or "none"
            raise InputError(f"proof.recordings: '{name}' is not under diagnosis.recordings ({known}); add it there")


def check_tried(settings: ProofSettings) -> None:
    """Check that the effects hidden in images are candidates there.

    Raises
    ------
    InputError
        If an effect is no candidate.
    """
    images = settings.images
    hidden = [KERNEL, *images.effects] if images.strengths or images.effects else []
    for name in hidden:
        if name not in images.tried:
            raise InputError(f"proof.images.tried: lacks '{name}', which the cases hide; add it")


def truths(settings: ProofSettings) -> dict[str, dict]:
    """Return {case: truth}, as for seal.sealed, from the section `proof` of the configuration."""
    plan = []
    for purpose, part in ((0, _plan(settings)), (2, _plan_of_images(settings))):
        order = generator(branch(settings.seed, purpose)).permutation(len(part))
        plan += [part[index] for index in order]
    return {
        case: _truth(case, kind_of(case, settings), *plan[number], settings.seed, number)
        for number, case in enumerate(cases(settings))
    }


def salt(seed: int, number: int) -> str:
    """Return the salt of a case: 64 hexadecimal digits."""
    words = branch(seed, 1, number, SALT).generate_state(8)
    return "".join(f"{word:08x}" for word in words)


def scan_seed(seed: int, number: int) -> Stream:
    """Return the stream of the noise in the scans of a case."""
    return branch(seed, 1, number, SCAN)


def _plan(settings: ProofSettings) -> list[tuple[str, str | None, str | None]]:
    """Category, strength and effect of each case of projections; the effects of pairs are drawn later.

    Raises
    ------
    InputError
        For effects that cannot be hidden.
    """
    effects = settings.effects or list(KNOWN)
    for name in effects:
        if name not in KNOWN:
            raise InputError(f"proof.effects: '{name}' cannot be hidden; use some of {', '.join(KNOWN)}")
    plan = [("single", strength, name) for name in effects for strength in settings.strengths]
    plan += [("none", None, None)] * settings.none
    plan += [("pair", None, None)] * settings.pairs
    return plan + [("unknown", None, name) for name in _unknown(settings)]


def _unknown(settings: ProofSettings) -> list[str]:
    """Return the unknown effect of each case: all equally often, in an order drawn from the seed.

    Raises
    ------
    InputError
        For an effect that does not exist.
    """
    kinds = settings.unknown_kinds or list(UNKNOWN)
    for name in kinds:
        if name not in UNKNOWN:
            raise InputError(f"proof.unknown_kinds: there is no '{name}'; use some of {', '.join(UNKNOWN)}")
    order = generator(branch(settings.seed, 3)).permutation(len(kinds))
    return [kinds[order[number % len(kinds)]] for number in range(settings.unknown)]


def _plan_of_images(settings: ProofSettings) -> list[tuple[str, str | None, str | None]]:
    """As _plan, for images.

    The simulated reconstruction has another kernel than the library's. Each case therefore hides a kernel, and a pair
    is a kernel and an effect.

    Raises
    ------
    InputError
        For too few rows and for effects that cannot be hidden.
    """
    wanted = settings.images
    if (wanted.strengths or wanted.effects) and settings.scan.rows < LEAST_ROWS:
        raise InputError(
            f"proof.scan.rows: {settings.scan.rows} rows cover too few slices in all views for proof.images; "
            f"give {LEAST_ROWS}, or set proof.images to {{strengths: [], effects: []}}"
        )
    for name in wanted.effects:
        if name == KERNEL or name not in CATALOGUE or not CATALOGUE[name].known:
            names = ", ".join(other for other in CATALOGUE if other != KERNEL and CATALOGUE[other].known)
            raise InputError(
                f"proof.images.effects: '{name}' cannot be hidden together with a kernel; use some of {names}"
            )
    plan = [("single", strength, KERNEL) for strength in wanted.strengths]
    return plan + [("pair", None, name) for name in wanted.effects]


def _truth(case, kind, category, strength, effect, seed, number) -> dict:
    random = generator(branch(seed, 1, number, TRUTH))
    names = [] if effect is None else [effect]
    if category == "pair":
        names = _pair(random) if effect is None else [KERNEL, effect]
    drawn = []
    for name in names:
        # Pairs and unknown effects are not weak, since undetectable effects cannot be distinguished. The kernel of a
        # pair on images is weak: it is as close to the assumed kernel as the simulated reconstruction can be.
        weak_kernel = kind == "images" and name == KERNEL
        size = strength or ("weak" if weak_kernel else str(random.choice(STRENGTHS[1:])))
        made, comparable = CATALOGUE[name].draw(size, random)
        if kind == "images":  # images have no readout units
            comparable = {key: value for key, value in comparable.items() if "_units" not in key}
        drawn.append(
            {
                "name": name,
                "known": CATALOGUE[name].known,
                "strength": size,
                "settings": made,
                "comparable": comparable,
                "right": CATALOGUE[name].right,
                "equals": [list(equivalent) for equivalent in CATALOGUE[name].equals],
            }
        )
    where = {domain for name in names for domain in CATALOGUE[name].where}
    if kind == "images":
        where = set(IMAGE)
    return {
        "case": case,
        "number": number,
        "kind": kind,
        "phantom": phantom_of(case),
        "category": category,
        "strength": strength or (drawn[0]["strength"] if category == "unknown" else None),
        "effects": drawn,
        "where": sorted(where),
    }


def _pair(random: np.random.Generator) -> list[str]:
    """Draw two effects of different groups, in the order of the catalogue."""
    while True:
        first, second = sorted(random.choice(len(KNOWN), 2, replace=False))
        groups = [CATALOGUE[KNOWN[index]].alike for index in (first, second)]
        if not groups[0] or groups[0] != groups[1]:
            return [KNOWN[first], KNOWN[second]]
