"""One case of the blind validation: its truth, its diagnosis and its agreement on another protocol."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

from ...base.errors import InputError
from ...diagnosis.residuals.residual_tests import ALPHA
from ...diagnosis.verdict.verdict import VERDICTS
from ...diagnosis.verdict_text import PRACTICAL
from ...physics.effect import names
from . import seal
from .catalogue import STRENGTHS

CATEGORIES = ("single", "none", "pair", "unknown")
KINDS = ("projections", "images")
MATCH, EXPLAINED, PARTLY, UNEXPLAINED = VERDICTS
MATCHES = (MATCH, PRACTICAL)  # nothing relevant is missing
ADMITTED = (PARTLY, UNEXPLAINED)  # verdicts that report unexplained differences
# Keys of a diagnosis that are scored or shown.
SCORED = (
    *("recording", "verdict", "sentence", "locations", "effects", "ambiguous_with", "ruled_out"),
    *("excess_removed", "remainder_sd"),
)
EFFECTS_OF = {"single": 1, "none": 0, "pair": 2}  # number of effects, all of them in the library


@dataclass(frozen=True)
class Case:
    """A scored case.

    Attributes
    ----------
    truth : dict
        Content of the sealed document.
    diagnosis : dict
        Content of diagnosis.json.
    other : dict or None
        Metrics of agreement on the held-out protocol; None if there are none.
    """

    truth: dict
    diagnosis: dict
    other: dict | None = None

    @property
    def name(self) -> str:
        """Published name of the case."""
        return self.truth["case"]

    @property
    def category(self) -> str:
        """One of CATEGORIES."""
        return self.truth["category"]

    @property
    def kind(self) -> str:
        """One of KINDS."""
        return self.truth["kind"]

    @property
    def strength(self) -> str | None:
        """One of STRENGTHS; None for pairs and for cases without a hidden effect."""
        return self.truth["strength"]

    @property
    def verdict(self) -> str:
        """One of VERDICTS."""
        return self.diagnosis["verdict"]

    @property
    def in_library(self) -> bool:
        """Whether the library has every hidden effect."""
        return self.category != "unknown"

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden effects."""
        return tuple(effect["name"] for effect in self.truth["effects"])

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the effects in the order of selection."""
        return tuple(effect["name"] for effect in self.diagnosis["effects"])

    @property
    def first(self) -> str | None:
        """Effect that was named first, or None."""
        return self.named[0] if self.named else None

    def with_alternatives(self, effect: str) -> set[str]:
        """Return a named effect and its reported alternatives, which explain the data as well."""
        return {effect, *self.diagnosis["ambiguous_with"].get(effect, ())}

    @property
    def first_right(self) -> bool:
        """Whether the effect named first is a hidden effect."""
        return self.first in self.hidden

    @property
    def first_or_alternative_right(self) -> bool:
        """Whether the effect named first, or one of its alternatives, is a hidden effect."""
        return self.first is not None and bool(self.with_alternatives(self.first) & set(self.hidden))

    @property
    def exact(self) -> bool:
        """Whether precisely the hidden effects were named. Without a hidden effect: whether the verdict is a match."""
        return set(self.named) == set(self.hidden) and (bool(self.hidden) or self.verdict in MATCHES)

    @property
    def all_named(self) -> bool:
        """Whether every hidden effect was named."""
        return set(self.hidden) <= set(self.named)

    @property
    def all_or_alternatives_named(self) -> bool:
        """Whether each hidden effect belongs to a separate named effect, as itself or as an alternative."""
        groups = [self.with_alternatives(name) for name in self.named]
        return any(
            all(effect in group for effect, group in zip(self.hidden, chosen, strict=True))
            for chosen in permutations(groups, len(self.hidden))
        )

    @property
    def located(self) -> bool:
        """Whether a significant difference was found in one of the domains where the effect should show."""
        return any(
            location["domain"] in self.truth["where"] and location["p"] < ALPHA
            for location in self.diagnosis["locations"]
        )

    @property
    def equivalent_named(self) -> bool:
        """Whether precisely a set of effects that is equivalent to the missing physics was named."""
        equivalents = [set(names) for effect in self.truth["effects"] for names in effect.get("equals", ())]
        return set(self.named) in equivalents

    @property
    def reported_unexplained(self) -> bool:
        """Whether the verdict reports unexplained differences or names an equivalent of the missing physics."""
        return self.verdict in ADMITTED or self.equivalent_named

    @property
    def right(self) -> bool:
        """Whether the answer was the best possible one for the category of the case."""
        if self.category == "none":
            return self.verdict in MATCHES
        if self.category == "unknown":
            return self.reported_unexplained
        return self.first_right if self.category == "single" else self.all_named


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
    published = seal.read(seals)
    truths = {}
    for path in sealed:
        truth = checked(seal.open_seal(path, published), path)
        truths[truth["case"]] = truth
    bound = {seal.read(path).get("case"): path for path in verdicts}
    diagnosed = {Path(path).parent.name: path for path in diagnoses}
    tables = {Path(path).parent.name: path for path in others}
    for case in published:
        for kind, files in (("sealed truth", truths), ("diagnosis", diagnosed), ("verdict", bound)):
            if case not in files:
                raise InputError(f"{seals}: {case} was published but has no {kind}; run the missing jobs")
    return [
        Case(
            truths[case],
            complete(seal.check_verdict(diagnosed[case], bound[case], tables.get(case)), diagnosed[case], case),
            metrics(tables[case]) if case in tables else None,
        )
        for case in sorted(published)
    ]


def checked(truth: dict, source: str | Path) -> dict:
    """Return the truth if it is consistent, else raise an InputError that names `source`."""
    try:
        effects, category = truth["effects"], truth["category"]
        known = [effect["known"] for effect in effects]
        if truth["kind"] not in KINDS or category not in CATEGORIES or truth["strength"] not in (*STRENGTHS, None):
            raise ValueError("kind, category or strength is unknown")
        for effect in effects:
            if effect["known"] != (effect["name"] in names()):
                has = "has" if effect["name"] in names() else "lacks"
                raise ValueError(f"the library {has} {effect['name']}, but `known` says otherwise")
            if not isinstance(effect["comparable"], Mapping):
                raise ValueError(f"comparable of {effect['name']} is not a mapping")
        if category == "unknown" and all(known):
            raise ValueError("the category is unknown, but the library has every hidden effect")
        if category in EFFECTS_OF and (len(effects) != EFFECTS_OF[category] or not all(known)):
            raise ValueError(f"category {category} does not fit the effects {[effect['name'] for effect in effects]}")
        if category == "single" and truth["strength"] is None:
            raise ValueError("a single effect has no strength")
        if not isinstance(truth["where"], list) or not isinstance(truth["phantom"], str):
            raise ValueError("where is not a list, or phantom is not a name")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{source}: is not the truth of a case ({' '.join(str(error).split())}); make the suite again"
        ) from None
    return truth


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
    if missing or diagnosis["verdict"] not in (*VERDICTS, PRACTICAL):
        what = f"it has no {', '.join(missing)}" if missing else f"verdict {diagnosis['verdict']!r}"
        raise InputError(f"{source}: is not a diagnosis that can be scored ({what}); diagnose the case again")
    if recording not in (None, diagnosis["recording"]):
        raise InputError(f"{source}: is the diagnosis of {diagnosis['recording']!r}; diagnose {recording} again")
    return diagnosis


def metrics(path: str | Path) -> dict:
    """Read the metrics of a table of agreement, or of a file with metrics alone.

    Raises
    ------
    InputError
        If the file is broken.
    """
    content = seal.read(path)
    found = content.get("metrics", content)
    for name, entry in found.items():
        if not isinstance(entry, Mapping) or not {"before", "after", "floor"} <= set(entry):
            raise InputError(f"{path}: {name} has no before, after and floor; is this a table of agreement?")
    return found
