"""One case of the blind validation: its truth and the verdict on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

from ...base.errors import InputError
from ...diagnosis.residuals.residual_tests import ALPHA
from ...diagnosis.verdict_text import MATCH, PARTLY_EXPLAINED, PRACTICAL, UNEXPLAINED
from ...physics.effect import names
from .hidden_effect import EQUATIONS, STRENGTHS
from .missing_effects import OF_OBJECT

CATEGORIES = ("single", "none", "pair", "unknown")
KINDS = ("projections", "images")
MATCHES = (MATCH, PRACTICAL)  # nothing relevant is missing
ADMITTED = (PARTLY_EXPLAINED, UNEXPLAINED)  # verdicts that report unexplained differences
EFFECTS_OF = {"single": 1, "none": 0, "pair": 2}  # number of effects, all of them in the library


@dataclass(frozen=True)
class Case:
    """A scored case.

    Attributes
    ----------
    truth : dict
        Content of the sealed document.
    verdict : dict
        Verdict document of any program (schemas/verdict.schema.yaml).
    diagnosis : dict or None
        Content of diagnosis.json; None if another program gave the verdict.
    other : dict or None
        Metrics of agreement on the held-out protocol; None if there are none.
    """

    truth: dict
    verdict: dict
    diagnosis: dict | None = None
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
    def classes(self) -> dict[str, str]:
        """Simulator, geometry and object of the case, and the hidden effect if it is a single one."""
        effect = {"effect": self.hidden[0]} if len(self.hidden) == 1 else {}
        return {name: self.truth[name] for name in ("simulator", "geometry", "object")} | effect

    @property
    def in_library(self) -> bool:
        """Whether the library has every hidden effect."""
        return self.category != "unknown"

    @property
    def own_equation(self) -> bool:
        """Whether an equation of the library, implemented again, makes a hidden effect."""
        return any(effect["equation"] == "own" for effect in self.truth["effects"])

    @property
    def undeclared(self) -> bool:
        """Whether the scan has small deviations that the diagnosis does not know."""
        return bool(self.truth["imperfections"]["undeclared"])

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden effects."""
        return tuple(effect["name"] for effect in self.truth["effects"])

    @property
    def groups(self) -> Sequence[Sequence[str]]:
        """Named effects in the order of rank, each with the effects that were reported as equal.

        If the verdict is that nothing relevant is missing, named effects count only if the hidden effect is weak.
        Otherwise, they would count both as found and as no false alarm.
        """
        return () if self.match and self.strength != "weak" else self.verdict["effects"]

    @property
    def named(self) -> tuple[str, ...]:
        """First effect of each group."""
        return tuple(group[0] for group in self.groups)

    @property
    def first(self) -> str | None:
        """Effect that was named first, or None."""
        return self.named[0] if self.named else None

    @property
    def unexplained(self) -> bool:
        """Whether the verdict reports unexplained differences."""
        return self.verdict["unexplained"]

    @property
    def match(self) -> bool:
        """Whether the verdict is that nothing relevant is missing."""
        return self.verdict.get("match", not self.verdict["effects"] and not self.unexplained)

    @property
    def by_significance(self) -> Case:
        """The case with a match only if no effect is named, however irrelevant."""
        return replace(self, verdict=self.verdict | {"match": self.match and not self.verdict["effects"]})

    def with_alternatives(self, effect: str) -> set[str]:
        """Return a named effect and the effects that were reported as equal."""
        return {name for group in self.groups if group[0] == effect for name in group}

    @property
    def first_credit(self) -> float:
        """Score for the effect ranked first: 1/k if a hidden effect is in the first group, of k effects; else 0."""
        group = self.groups[0] if self.groups else ()
        return 1 / len(group) if set(group) & set(self.hidden) else 0.0

    @property
    def first_right(self) -> bool:
        """Whether the effect named first is a hidden effect."""
        return self.first in self.hidden

    @property
    def first_or_alternative_right(self) -> bool:
        """Whether the effect named first, or one of its alternatives, is a hidden effect."""
        return self.first_credit > 0

    @property
    def exact(self) -> bool:
        """Whether precisely the hidden effects were named, none in a group. If nothing is hidden: a match."""
        alone = all(len(group) == 1 for group in self.groups)
        return alone and set(self.named) == set(self.hidden) and (bool(self.hidden) or self.match)

    @property
    def all_named(self) -> bool:
        """Whether every hidden effect was named."""
        return set(self.hidden) <= set(self.named)

    @property
    def all_credit(self) -> float:
        """Score for all hidden effects: each in a separate group, with the product of 1/k over these groups."""
        chosen = (
            groups
            for groups in permutations(self.groups, len(self.hidden))
            if all(effect in group for effect, group in zip(self.hidden, groups, strict=True))
        )
        return max((math.prod(1 / len(group) for group in groups) for groups in chosen), default=0.0)

    @property
    def all_or_alternatives_named(self) -> bool:
        """Whether each hidden effect belongs to a separate named effect, as itself or as an alternative."""
        return self.all_credit > 0

    @property
    def located(self) -> bool:
        """Whether a significant difference was found in one of the domains where the effect should show."""
        return any(
            location["domain"] in self.truth["where"] and location["p"] < ALPHA
            for location in self.diagnosis["locations"]
        )

    @property
    def equivalent_named(self) -> bool:
        """Whether precisely the hidden faults, or a set of effects that is equivalent to them, were named."""
        equivalents = [set(names) for effect in self.truth["effects"] for names in effect.get("equals", ())]
        return set(self.named) in [set(self.hidden), *equivalents]

    @property
    def reported_unexplained(self) -> bool:
        """Whether the verdict reports the fault.

        It reports unexplained differences, names an equivalent of the missing physics, or for a fault of the object
        reports another object.
        """
        of_object = self.verdict.get("other_object", False) and set(self.hidden) <= set(OF_OBJECT)
        return self.unexplained or self.equivalent_named or of_object

    @property
    def right(self) -> bool:
        """Whether the answer was the best possible one for the category of the case."""
        if self.category == "none":
            return self.match
        if self.category == "unknown":
            return self.reported_unexplained
        return self.first_right if self.category == "single" else self.all_named


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
            if effect["equation"] not in EQUATIONS:
                raise ValueError(f"equation of {effect['name']} is none of {', '.join(EQUATIONS)}")
        if category == "unknown" and all(known):
            raise ValueError("the category is unknown, but the library has every hidden effect")
        if category in EFFECTS_OF and (len(effects) != EFFECTS_OF[category] or not all(known)):
            raise ValueError(f"category {category} does not fit the effects {[effect['name'] for effect in effects]}")
        if category == "single" and truth["strength"] is None:
            raise ValueError("a single effect has no strength")
        if not isinstance(truth["where"], list) or not isinstance(truth["imperfections"]["undeclared"], Mapping):
            raise ValueError("where is not a list, or undeclared is not a mapping")
        if not all(isinstance(truth[key], str) for key in ("phantom", "simulator", "geometry", "object")):
            raise ValueError("phantom, simulator, geometry or object is not a name")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{source}: is not the truth of a case ({' '.join(str(error).split())}); make the suite again"
        ) from None
    return truth
