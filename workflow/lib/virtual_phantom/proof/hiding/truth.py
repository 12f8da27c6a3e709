"""Fields of a truth that say who made a case and how."""

# Imports stay light: sealing does not depend on the code of the diagnosis.

from __future__ import annotations

from collections.abc import Mapping

from .catalogue import MODELS

# Sources of the equation that makes a hidden effect, {name: description}
EQUATIONS = {
    "simulator": "the simulator's own",
    "other": "another equation than the library's",
    "own": "the library's equation, written again",
}


def completed(truth: Mapping) -> dict:
    """Return a truth with the fields that suites without object errors lack.

    Their only simulator is XCIST, all scans are circles of a flat detector, and nothing deviates from the description.
    """
    equations = {name: source for source, made in zip(EQUATIONS, MODELS.values(), strict=True) for name in made}
    missing = {
        "simulator": "xcist",
        "geometry": "circular, flat detector",
        "object": truth["phantom"],
        "imperfections": {"declared": {}, "undeclared": {}},
    }
    effects = [{"equation": equations.get(effect["name"], "other")} | effect for effect in truth["effects"]]
    return missing | dict(truth) | {"effects": effects}
