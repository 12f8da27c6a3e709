"""Settings of the study sizes; an installed package does not contain the folder config."""

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


def paper_groups() -> dict:
    """Return grid, scan, levels, protocols and analyses of config/paper_groups.yaml."""
    return sizes()["normal"]
