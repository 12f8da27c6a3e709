"""The default study's numbers, for what is not given: those of config/config.yaml, which a package does not hold."""

from __future__ import annotations

import copy
from functools import cache

from ..base.data import RESOURCES, shipped_yaml


@cache
def _read() -> dict:
    return shipped_yaml(RESOURCES / "study_sizes.yaml")


def sizes() -> dict:
    """What each size of a study asks for: study_sizes.yaml of the library's resources."""
    return copy.deepcopy(_read())


def default_study() -> dict:
    """Of them the default study: grid, scan, levels, protocols, analyses, without what the schema has by default."""
    return sizes()["normal"]
