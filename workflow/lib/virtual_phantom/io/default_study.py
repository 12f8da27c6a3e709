"""Settings of the default study, as in config/config.yaml, which an installed package does not contain."""

from __future__ import annotations

import copy
from functools import cache

from ..base.data import RESOURCES, shipped_yaml


@cache
def _read() -> dict:
    return shipped_yaml(RESOURCES / "study_sizes.yaml")


def sizes() -> dict:
    """Return the settings of each study size: study_sizes.yaml of the package."""
    return copy.deepcopy(_read())


def default_study() -> dict:
    """Return the default study: grid, scan, levels, protocols, analyses, without keys that have schema defaults."""
    return sizes()["normal"]
