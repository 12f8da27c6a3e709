"""Which cases a suite has, and what is concealed in each: drawn from the suite's seed alone."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ...base.errors import InputError
from ...base.streams import Stream, branch, generator
from .catalogue import CATALOGUE, IMAGE, STRENGTHS
from .lacking import LACKING
from .objects import OBJECTS

PHANTOMS = tuple(OBJECTS)
KERNEL = "reconstruction_kernel"
LEAST_ROWS = 6  # for the four slices of an image
PROTOCOLS = ("scan", "held_out_protocol")  # sections of the configuration
TRUTH, SALT, SCAN = range(3)  # branches of a case's seed
KNOWN = tuple(name for name, one in CATALOGUE.items() if one.known and not one.of_images)
UNKNOWN = tuple(LACKING)


def cases(settings: Mapping) -> list[str]:
    """Names of all cases, which tell nothing of what is concealed."""
    count = len(_plan(settings)) + len(_plan_of_images(settings))
    return [f"case_{number:02d}" for number in range(1, 1 + count)]


def kind_of(case: str, settings: Mapping) -> str:
    """What a case records: no secret, and told by its number. Images come after all projections."""
    return "projections" if _number(case) <= len(_plan(settings)) else "images"


def phantom_of(case: str) -> str:
    """What is scanned in a case: no secret, and told by its number alone."""
    return PHANTOMS[_number(case) % len(PHANTOMS)]


def views_of(kind: str, settings: Mapping) -> tuple[int, int]:
    """Views of the scans by PROTOCOLS.

    Images of few views are mostly streaks, which no two reconstructions share.

    Parameters
    ----------
    kind : str
        Of case.KINDS.
    settings : mapping
        As `truths` takes them.

    Returns
    -------
    tuple of 2 int
    """
    times = settings["images"]["views_times"] if kind == "images" else 1
    return tuple(settings[one]["views"] * times for one in PROTOCOLS)


def _number(case: str) -> int:
    return int(case.rpartition("_")[2])


def check_recordings(names: Sequence[str], diagnosed: Collection[str]) -> None:
    """Check the names of recordings that are shown beside the cases.

    Parameters
    ----------
    diagnosed : collection of str
        Names under `diagnosis.recordings`.

    Raises
    ------
    InputError
        For names that are not there, or are like those of cases.
    """
    for name in names:
        if re.fullmatch(r"case_[0-9]+", name):
            raise InputError(f"proof.recordings: '{name}' is the name of a case; give the recording another one")
        if name not in diagnosed:
            known = ", ".join(diagnosed) or "none"
            raise InputError(f"proof.recordings: '{name}' is not under diagnosis.recordings ({known}); add it there")


def check_tried(settings: Mapping) -> None:
    """Check that what is concealed in images is tried there.

    Raises
    ------
    InputError
        For effects that are not.
    """
    images = settings["images"]
    concealed = [KERNEL, *images["effects"]] if images["strengths"] or images["effects"] else []
    for name in concealed:
        if name not in images["tried"]:
            raise InputError(f"proof.images.tried: lacks '{name}', which is concealed; add it")


def truths(settings: Mapping) -> dict[str, dict]:
    """What is concealed in each case.

    Parameters
    ----------
    settings : mapping
        The section `proof` of the configuration: seed, effects, strengths, and how many cases of nothing, of pairs and
        of unknown effects.

    Returns
    -------
    dict of str to dict
        {case: truth}, as seal.sealed takes them.
    """
    plan = []
    for purpose, part in ((0, _plan(settings)), (2, _plan_of_images(settings))):
        order = generator(branch(settings["seed"], purpose)).permutation(len(part))
        plan += [part[place] for place in order]
    return {
        case: _truth(case, kind_of(case, settings), *plan[number], settings["seed"], number)
        for number, case in enumerate(cases(settings))
    }


def salt(seed: int, number: int) -> str:
    """64 hexadecimal digits of a case of its own."""
    words = branch(seed, 1, number, SALT).generate_state(8)
    return "".join(f"{word:08x}" for word in words)


def scan_seed(seed: int, number: int) -> Stream:
    """Of the noise of a case's scans."""
    return branch(seed, 1, number, SCAN)


def _plan(settings: Mapping) -> list[tuple[str, str | None, str | None]]:
    """Category, strength and effect of cases of projections; effects of pairs are drawn later.

    Parameters
    ----------
    settings : mapping
        As `truths` takes them.

    Raises
    ------
    InputError
        For effects that cannot be concealed.
    """
    effects = settings.get("effects") or list(KNOWN)
    for name in effects:
        if name not in KNOWN:
            raise InputError(f"proof.effects: '{name}' cannot be concealed; use some of {', '.join(KNOWN)}")
    plan = [("single", strength, name) for name in effects for strength in settings["strengths"]]
    plan += [("none", None, None)] * settings["none"]
    plan += [("pair", None, None)] * settings["pairs"]
    return plan + [("unknown", None, name) for name in _unknown(settings)]


def _unknown(settings: Mapping) -> list[str]:
    """Kinds that the library lacks, of cases in turn: each as often as the others, in an order drawn from the seed.

    Parameters
    ----------
    settings : mapping
        As `truths` takes them.

    Raises
    ------
    InputError
        For a kind that there is not.
    """
    kinds = settings.get("unknown_kinds") or list(UNKNOWN)
    for name in kinds:
        if name not in UNKNOWN:
            raise InputError(f"proof.unknown_kinds: there is no '{name}'; use some of {', '.join(UNKNOWN)}")
    order = generator(branch(settings["seed"], 3)).permutation(len(kinds))
    return [kinds[order[number % len(kinds)]] for number in range(settings["unknown"])]


def _plan_of_images(settings: Mapping) -> list[tuple[str, str | None, str | None]]:
    """As _plan, of images.

    Other reconstructions than the library's have other kernels, so that each case conceals one, and a pair is that and
    an effect.

    Parameters
    ----------
    settings : mapping
        As `truths` takes them.

    Raises
    ------
    InputError
        For too few rows, and effects that cannot be concealed.
    """
    wanted = settings["images"]
    if (wanted["strengths"] or wanted["effects"]) and settings["scan"]["rows"] < LEAST_ROWS:
        raise InputError(
            f"proof.scan.rows: {settings['scan']['rows']} rows see too few slices from everywhere for proof.images; "
            f"give {LEAST_ROWS}, or no images: {{strengths: [], effects: []}}"
        )
    for name in wanted["effects"]:
        if name == KERNEL or name not in CATALOGUE or not CATALOGUE[name].known:
            names = ", ".join(one for one in CATALOGUE if one != KERNEL and CATALOGUE[one].known)
            raise InputError(f"proof.images.effects: '{name}' cannot be concealed beside a kernel; use some of {names}")
    plan = [("single", strength, KERNEL) for strength in wanted["strengths"]]
    return plan + [("pair", None, name) for name in wanted["effects"]]


def _truth(case, kind, category, strength, effect, seed, number) -> dict:
    random = generator(branch(seed, 1, number, TRUTH))
    names = [] if effect is None else [effect]
    if category == "pair":
        names = _pair(random) if effect is None else [KERNEL, effect]
    drawn = []
    for name in names:
        # Of pairs and unknown effects no weak ones: what cannot be seen cannot be told apart. But the kernel beside an
        # effect on images is as near the diagnosis's own as a reconstruction gets.
        near = kind == "images" and name == KERNEL
        size = strength or ("weak" if near else str(random.choice(STRENGTHS[1:])))
        made, comparable = CATALOGUE[name].draw(size, random)
        if kind == "images":  # which have no readout units
            comparable = {key: value for key, value in comparable.items() if "_units" not in key}
        drawn.append(
            {
                "name": name,
                "known": CATALOGUE[name].known,
                "strength": size,
                "settings": made,
                "comparable": comparable,
                "right": CATALOGUE[name].right,
                "equals": [list(one) for one in CATALOGUE[name].equals],
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
    """Two effects of different groups, in the order of the catalogue."""
    while True:
        first, second = sorted(random.choice(len(KNOWN), 2, replace=False))
        groups = [CATALOGUE[KNOWN[index]].alike for index in (first, second)]
        if not groups[0] or groups[0] != groups[1]:
            return [KNOWN[first], KNOWN[second]]
