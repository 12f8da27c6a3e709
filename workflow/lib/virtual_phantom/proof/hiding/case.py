"""One case of the blind test: its truth, what the diagnosis said of it, and how the physics did on another protocol."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

from ...base.errors import InputError
from ...diagnosis.residuals.residual_tests import ALPHA
from ...diagnosis.verdict.verdict import VERDICTS
from ...physics.effect import names
from . import seal
from .catalogue import STRENGTHS

CATEGORIES = ("single", "none", "pair", "unknown")
KINDS = ("projections", "images")
MATCH, EXPLAINED, PARTLY, UNEXPLAINED = VERDICTS
ADMITTED = (PARTLY, UNEXPLAINED)  # verdicts that own up to something the library does not explain
CONCEALED = {"single": 1, "none": 0, "pair": 2}  # number of effects, all of them in the library


@dataclass(frozen=True)
class Case:
    """What counts for the score.

    Attributes
    ----------
    truth : dict
        As sealed.
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
        """As published."""
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
        """One of STRENGTHS; None of pairs, and where nothing is concealed."""
        return self.truth["strength"]

    @property
    def verdict(self) -> str:
        """One of VERDICTS."""
        return self.diagnosis["verdict"]

    @property
    def in_library(self) -> bool:
        """Whether everything concealed, if anything, could have been named."""
        return self.category != "unknown"

    @property
    def concealed(self) -> tuple[str, ...]:
        """Effects that were concealed."""
        return tuple(effect["name"] for effect in self.truth["effects"])

    @property
    def named(self) -> tuple[str, ...]:
        """Effects in the order in which they were chosen."""
        return tuple(effect["name"] for effect in self.diagnosis["effects"])

    @property
    def first(self) -> str | None:
        """The effect that was named first, if any was."""
        return self.named[0] if self.named else None

    def with_stand_ins(self, effect: str) -> set[str]:
        """A named effect and those reported to explain the data as well in its place."""
        return {effect, *self.diagnosis["ambiguous_with"].get(effect, ())}

    @property
    def first_right(self) -> bool:
        """Whether the effect named first was concealed."""
        return self.first in self.concealed

    @property
    def first_or_stand_in_right(self) -> bool:
        """Whether the effect named first, or one reported to explain the data as well, was concealed."""
        return self.first is not None and bool(self.with_stand_ins(self.first) & set(self.concealed))

    @property
    def exact(self) -> bool:
        """Whether precisely the effects concealed were named; of nothing concealed, whether the verdict is a match."""
        return set(self.named) == set(self.concealed) and (bool(self.concealed) or self.verdict == MATCH)

    @property
    def all_named(self) -> bool:
        """Whether every concealed effect was named."""
        return set(self.concealed) <= set(self.named)

    @property
    def all_or_stand_ins_named(self) -> bool:
        """Whether each concealed effect is, or stands in for, a named one of its own."""
        groups = [self.with_stand_ins(name) for name in self.named]
        return any(
            all(effect in group for effect, group in zip(self.concealed, chosen, strict=True))
            for chosen in permutations(groups, len(self.concealed))
        )

    @property
    def located(self) -> bool:
        """Whether a significant difference was found in one of the domains where it should show."""
        return any(
            place["domain"] in self.truth["where"] and place["p"] < ALPHA for place in self.diagnosis["locations"]
        )

    @property
    def equal_named(self) -> bool:
        """Whether effects that stand by right for what the library lacks were named, and nothing else."""
        equals = [set(one) for effect in self.truth["effects"] for one in effect.get("equals", ())]
        return set(self.named) in equals

    @property
    def owned_up(self) -> bool:
        """Whether the verdict says that something outside of the library is left, or names an equal of it."""
        return self.verdict in ADMITTED or self.equal_named

    @property
    def right(self) -> bool:
        """Whether the answer was the best one: of what the library lacks, that something is left, or an equal."""
        if self.category == "none":
            return self.verdict == MATCH
        if self.category == "unknown":
            return self.owned_up
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
        The published ones.
    diagnoses, others : iterable of str or Path
        Files in a folder of the case's name each; `others` are tables of agreement by another protocol.

    Returns
    -------
    list of Case
        In the order of their names.

    Raises
    ------
    InputError
        For what was tampered with, is missing (every published case counts) or makes no sense.
    """
    published = seal.read(seals)
    truths = {}
    for path in sealed:
        truth = checked(seal.open_seal(path, published), path)
        truths[truth["case"]] = truth
    bound = {seal.read(path).get("case"): path for path in verdicts}
    said = {Path(path).parent.name: path for path in diagnoses}
    tables = {Path(path).parent.name: path for path in others}
    for case in published:
        for what, found in (("sealed truth", truths), ("diagnosis", said), ("verdict", bound)):
            if case not in found:
                raise InputError(f"{seals}: {case} was published, but it has no {what}; every published case counts")
    return [
        Case(
            truths[case],
            complete(seal.check_verdict(said[case], bound[case], tables.get(case)), said[case], case),
            metrics(tables[case]) if case in tables else None,
        )
        for case in sorted(published)
    ]


def checked(truth: dict, source: str | Path) -> dict:
    """The truth, if it makes sense; else InputError naming `source`."""
    try:
        effects, category = truth["effects"], truth["category"]
        known = [effect["known"] for effect in effects]
        if truth["kind"] not in KINDS or category not in CATEGORIES or truth["strength"] not in (*STRENGTHS, None):
            raise ValueError("kind, category or strength is none that there is")
        for effect in effects:
            if effect["known"] != (effect["name"] in names()):
                has = "has" if effect["name"] in names() else "lacks"
                raise ValueError(f"the library {has} {effect['name']}, and `known` says otherwise")
            if not isinstance(effect["comparable"], Mapping):
                raise ValueError(f"comparable of {effect['name']} is no table")
        if category == "unknown" and all(known):
            raise ValueError("nothing that the library lacks is concealed, and the category is unknown")
        if category in CONCEALED and (len(effects) != CONCEALED[category] or not all(known)):
            raise ValueError(f"category {category} does not fit the effects {[one['name'] for one in effects]}")
        if category == "single" and truth["strength"] is None:
            raise ValueError("a single effect has no strength")
        if not isinstance(truth["where"], list) or not isinstance(truth["phantom"], str):
            raise ValueError("where is no list, or phantom no name")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source}: is no truth of a case ({' '.join(str(error).split())}); make it again") from None
    return truth


def complete(diagnosis: dict, source: str | Path, recording: str | None = None) -> dict:
    """The diagnosis, if it has what is scored, and is of this recording.

    Parameters
    ----------
    source : str or Path
        What the message begins with.
    recording : str, optional
        None: of any.

    Raises
    ------
    InputError
        If it has not, or is of another.
    """
    needed = (
        "recording",
        "verdict",
        "sentence",
        "locations",
        "effects",
        "ambiguous_with",
        "ruled_out",
        "excess_removed",
        "remainder_sd",
    )
    missing = [key for key in needed if key not in diagnosis]
    if missing or diagnosis["verdict"] not in VERDICTS:
        what = f"it has no {', '.join(missing)}" if missing else f"verdict {diagnosis['verdict']!r}"
        raise InputError(f"{source}: is no diagnosis that can be scored ({what}); diagnose the case again")
    if recording not in (None, diagnosis["recording"]):
        raise InputError(f"{source}: is the diagnosis of {diagnosis['recording']!r}; diagnose {recording} again")
    return diagnosis


def metrics(path: str | Path) -> dict:
    """Metrics of a table of agreement, or of its metrics alone.

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
