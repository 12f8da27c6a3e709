"""Shipped configurations with all defaults."""

from pathlib import Path

from virtual_phantom.base.settings import to_mapping
from virtual_phantom.config.config import read_study
from virtual_phantom.config.read_config import read_configs

CONFIG = Path(__file__).resolve().parents[2] / "config"


def resolved(name: str, **changes) -> dict:
    """Return config/NAME, with other values of some sections, as the scripts of pages get it."""
    lines, settings = read_configs([CONFIG / name])
    assert not lines, lines
    return to_mapping(read_study(settings | changes))
