"""Cases of a suite, their worlds and the effects hidden in each, drawn from the seed of the suite alone."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ...base.errors import InputError
from ...base.proof_settings import ProofSettings
from ...base.streams import Stream, branch, generator
from . import imperfections
from .catalogue import CATALOGUE, DEFINED_OTHERWISE, GVXR, XCIST, equation, simulated_by
from .hidden_effect import IMAGE, STRENGTHS
from .missing_effects import MISSING_EFFECTS
from .objects import BODY, DESCRIPTIONS, DISC, KINDS, ScannedObject, drawn_object
from .orbits import ARC, FULL, GEOMETRIES, Orbit, orbit_of

KERNEL = "reconstruction_kernel"
LEAST_ROWS = 6  # needed for the slices of an image
PROTOCOLS = ("scan", "held_out_protocol")  # sections of the configuration
PROJECTIONS, IMAGES = "projections", "images"
TRUTH, SALT, SCAN, OBJECT, WORLD = range(5)  # branches of a case's seed
KNOWN = tuple(name for name, effect in CATALOGUE.items() if effect.known and not effect.of_images)
UNKNOWN = tuple(MISSING_EFFECTS)
# Geometries of each simulator. The detector of gVirtualXray is flat.
ORBITS = {XCIST: GEOMETRIES, GVXR: tuple(name for name in GEOMETRIES if name != ARC)}


@dataclass(frozen=True)
class Planned:
    """Plan of one case; None for a property that is drawn later."""

    category: str
    strength: str | None
    effect: str | None
    simulator: str


@dataclass(frozen=True)
class World:
    """Public properties of a case: simulator, object, geometry, and the description of the object."""

    number: int
    kind: str
    simulator: str
    object: str
    geometry: str
    description: str

    @classmethod
    def of(cls, truth: Mapping) -> World:
        """Return the world of a truth."""
        return cls(**{field.name: truth[field.name] for field in fields(cls)})

    def shows(self, effect: str | None) -> bool:
        """Return whether the scan depends on an effect; True for effects that are drawn later."""
        return effect is None or not {self.object, self.description} & set(CATALOGUE[effect].unseen)

    def stated(self, seed: int) -> ScannedObject:
        """Return the stated object."""
        random = generator(branch(seed, 1, self.number, OBJECT))
        return drawn_object(self.object, self.description == DISC, random)

    def orbits(self, settings: ProofSettings) -> list[Orbit]:
        """Return the orbits of the two protocols."""
        stated, found = self.stated(settings.seed), []
        times = settings.images.views_times if self.kind == IMAGES else 1
        random = generator(branch(settings.seed, 1, self.number, OBJECT, 1))
        for protocol in PROTOCOLS:
            start = 0.0 if self.kind == IMAGES else float(random.uniform(0, 360))
            taken = getattr(settings, protocol)
            taken = replace(taken, views=taken.views * times)
            found.append(orbit_of(self.geometry, stated, settings.scan, taken, start))
        return found


def cases(settings: ProofSettings) -> list[str]:
    """List the names of all cases. A name does not reveal the hidden effects."""
    count = len(_plan(settings)) + len(_plan_of_images(settings))
    digits = max(2, len(str(count)))
    return [f"case_{number:0{digits}d}" for number in range(1, 1 + count)]


def worlds(settings: ProofSettings) -> dict[str, World]:
    """Return {case: world}. Images follow after all projections."""
    return {case: _world(*one) for case, one in _planned(settings).items()}


def singles(settings: ProofSettings) -> tuple[str, ...]:
    """Return the names of the cases with one hidden effect of the library."""
    return tuple(case for case, (_, _, planned) in _planned(settings).items() if planned.category == "single")


def _world(number: int, kind: str, planned: Planned) -> World:
    """Return the world of a case; the order of the cases is random, so that it does not depend on what is hidden."""
    if kind == IMAGES:
        return World(number, kind, planned.simulator, BODY, FULL, DESCRIPTIONS[BODY][0])
    shown = KINDS[number % len(KINDS)]
    geometries, descriptions = ORBITS[planned.simulator], DESCRIPTIONS[shown]
    geometry = geometries[number // len(KINDS) % len(geometries)]
    description = descriptions[number // (len(KINDS) * len(geometries)) % len(descriptions)]
    return World(number, kind, planned.simulator, shown, geometry, description)


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


def check_simulators(simulators: Collection[str]) -> None:
    """Raise an InputError if a simulator is not installed."""
    if GVXR in simulators and importlib.util.find_spec("gvxrPython3") is None:
        raise InputError(
            "proof.simulators: gvirtualxray needs the package gvxr, which is missing; run `make setup-proof` "
            "(Debian packages: environment-proof.txt), or use [xcist]"
        )


def check_tried(settings: ProofSettings) -> None:
    """Check that the hidden effects are candidates.

    Raises
    ------
    InputError
        If an effect is no candidate.
    """
    images, of_projections = settings.images, []
    of_images = [KERNEL, *images.effects] if images.strengths or images.effects else []
    if settings.tried is not None:
        found = (truth for truth in truths(settings).values() if truth["kind"] == PROJECTIONS)
        of_projections = [one["name"] for truth in found if truth["category"] != "unknown" for one in truth["effects"]]
    for section, hidden, tried in (
        ("proof.images", of_images, images.tried),
        ("proof", of_projections, settings.tried),
    ):
        lacking = [name for name in hidden if name not in (tried or ())]
        if lacking:
            raise InputError(f"{section}.tried: lacks '{lacking[0]}', which the cases hide; add it")


def truths(settings: ProofSettings) -> dict[str, dict]:
    """Return {case: truth}, as for seal.sealed, from the section `proof` of the configuration."""
    return {
        case: _truth(case, _world(number, kind, planned), planned, settings)
        for case, (number, kind, planned) in _planned(settings).items()
    }


def truth(case: str, settings: ProofSettings) -> dict:
    """Return the truth of one case."""
    number, kind, planned = _planned(settings)[case]
    return _truth(case, _world(number, kind, planned), planned, settings)


def _planned(settings: ProofSettings) -> dict[str, tuple[int, str, Planned]]:
    """Return {case: (number, kind, plan)}."""
    numbered = enumerate(zip(cases(settings), _ordered(settings), strict=True))
    return {case: (number, kind, planned) for number, (case, (kind, planned)) in numbered}


def _ordered(settings: ProofSettings) -> list[tuple[str, Planned]]:
    """Return kind and plan of all cases, in an order drawn from the seed.

    A case whose object cannot show its effect changes its place with the next one for which both can.
    """
    plan = []
    for kind, purpose, part in ((PROJECTIONS, 0, _plan(settings)), (IMAGES, 2, _plan_of_images(settings))):
        order = generator(branch(settings.seed, purpose)).permutation(len(part))
        plan += [(kind, part[index]) for index in order]

    def shown(number: int, at: int) -> bool:
        """Return whether the case at a place shows its effect at another place."""
        kind, planned = plan[at]
        return _world(number, kind, planned).shows(planned.effect)

    for here in range(len(plan)):
        if shown(here, here):
            continue
        for there in (*range(here + 1, len(plan)), *range(here)):
            if plan[here][0] == plan[there][0] and shown(here, there) and shown(there, here):
                plan[here], plan[there] = plan[there], plan[here]
                break
    return plan


def salt(seed: int, number: int) -> str:
    """Return the salt of a case: 64 hexadecimal digits."""
    words = branch(seed, 1, number, SALT).generate_state(8)
    return "".join(f"{word:08x}" for word in words)


def scan_seed(seed: int, number: int) -> Stream:
    """Return the stream of the noise in the scans of a case."""
    return branch(seed, 1, number, SCAN)


def _plan(settings: ProofSettings) -> list[Planned]:
    """Plan the cases of projections.

    Raises
    ------
    InputError
        For effects that cannot be hidden.
    """
    effects, simulators = settings.effects or list(KNOWN), settings.simulators
    for name in effects:
        if name not in KNOWN:
            raise InputError(f"proof.effects: '{name}' cannot be hidden; use some of {', '.join(KNOWN)}")
    plan = [
        Planned("single", strength, name, simulator)
        for simulator in simulators
        for name in effects
        if simulated_by(name, simulator)
        for strength in settings.strengths
    ]
    for category, count in (("none", settings.none), ("pair", settings.pairs)):
        plan += [Planned(category, None, None, simulators[number % len(simulators)]) for number in range(count)]
    return plan + _unknown(settings)


def _unknown(settings: ProofSettings) -> list[Planned]:
    """Plan the cases with an unknown effect: all equally often, in an order drawn from the seed.

    A case whose turn is a simulator that cannot hide its effect gets the first one that can. By default, effects that
    no simulator of the suite can hide are omitted.

    Raises
    ------
    InputError
        For an effect that does not exist, or that no simulator of the suite can hide.
    """
    able = {name: [one for one in settings.simulators if simulated_by(name, one)] for name in UNKNOWN}
    kinds = settings.unknown_kinds or [name for name in UNKNOWN if able[name]]
    for name in kinds:
        if name not in UNKNOWN:
            raise InputError(f"proof.unknown_kinds: there is no '{name}'; use some of {', '.join(UNKNOWN)}")
        if not able[name]:
            used = ", ".join(settings.simulators)
            raise InputError(f"proof.unknown_kinds: {used} cannot hide '{name}'; add {XCIST} to proof.simulators")
    order = generator(branch(settings.seed, 3)).permutation(len(kinds))
    plan = []
    for number in range(settings.unknown):
        name = kinds[order[number % len(kinds)]]
        # Each round of all kinds begins with the next simulator.
        wanted = settings.simulators[(number + number // len(kinds)) % len(settings.simulators)]
        plan.append(Planned("unknown", None, name, wanted if wanted in able[name] else able[name][0]))
    return plan


def _plan_of_images(settings: ProofSettings) -> list[Planned]:
    """As _plan, for images, which XCIST makes.

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
    plan = [Planned("single", strength, KERNEL, XCIST) for strength in wanted.strengths]
    return plan + [Planned("pair", None, name, XCIST) for name in wanted.effects]


def _truth(case: str, world: World, planned: Planned, settings: ProofSettings) -> dict:
    seed, category, kind = settings.seed, planned.category, world.kind
    random = generator(branch(seed, 1, world.number, TRUTH))
    names = [] if planned.effect is None else [planned.effect]
    if category == "pair":
        names = _pair(random, world) if planned.effect is None else [KERNEL, planned.effect]
    drawn = []
    for name in names:
        # Pairs and unknown effects are not weak, since undetectable effects cannot be distinguished. The kernel of a
        # pair on images is weak: it is as close to the assumed kernel as the simulated reconstruction can be.
        weak_kernel = kind == IMAGES and name == KERNEL
        size = planned.strength or ("weak" if weak_kernel else str(random.choice(STRENGTHS[1:])))
        made, comparable = CATALOGUE[name].draw(size, random)
        if kind == IMAGES:  # images have no readout units
            comparable = {key: value for key, value in comparable.items() if "_units" not in key}
        if name in DEFINED_OTHERWISE[world.simulator]:
            comparable = {}
        drawn.append(
            {
                "name": name,
                "known": CATALOGUE[name].known,
                "equation": equation(name, world.simulator),
                "strength": size,
                "settings": made,
                "comparable": comparable,
                "right": CATALOGUE[name].right,
                "equals": [list(equivalent) for equivalent in CATALOGUE[name].equals],
            }
        )
    where = {domain for name in names for domain in CATALOGUE[name].where}
    if kind == IMAGES:
        where = set(IMAGE)
    # The diagnosis of images has neither declared deviations nor uncertainty of the object.
    declared = settings.declared if kind == PROJECTIONS else 0
    random = generator(branch(seed, 1, world.number, WORLD))
    return {
        "case": case,
        "number": world.number,
        "kind": kind,
        "simulator": world.simulator,
        "phantom": world.object,
        "object": world.object,
        "geometry": world.geometry,
        "description": world.description,
        "category": category,
        "strength": planned.strength or (drawn[0]["strength"] if category == "unknown" else None),
        "effects": drawn,
        "where": sorted(where),
        "imperfections": imperfections.drawn(world.stated(seed), names, declared, random, world.simulator),
    }


def _pair(random: np.random.Generator, world: World) -> list[str]:
    """Draw two effects of different groups that the scan shows, in the order of the catalogue."""
    known = [name for name in KNOWN if simulated_by(name, world.simulator) and world.shows(name)]
    while True:
        first, second = sorted(random.choice(len(known), 2, replace=False))
        groups = [CATALOGUE[known[index]].alike for index in (first, second)]
        if not groups[0] or groups[0] != groups[1]:
            return [known[first], known[second]]
