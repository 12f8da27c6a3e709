"""Physics that a diagnosis found, as the study takes it."""

from __future__ import annotations

from pathlib import Path

import yaml

from ..base.errors import InputError, refusing
from ..io.files import read_text
from ..physics.effect import acts_on_images, checked


def read_found(path: str | Path) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """The effects of a physics.yaml.

    Returns
    -------
    of_scans, of_images : dict of str to dict of str to float
        {effect: {parameter: value}}, complete: those of the acquisition, and those that act on images.

    Raises
    ------
    InputError
        If it is missing or broken, or names no effect.
    """
    text = read_text(path, "make it again")
    with refusing(
        f"{path}: is no physics of a diagnosis", yaml.YAMLError, ValueError, TypeError, advice="make it again"
    ):
        stated = (yaml.safe_load(text) or {}).get("physics")
        effects = checked(stated or {}, str(path))
    if not effects:
        sentence = text.partition("\n")[0].lstrip("# ").rstrip(".")
        raise InputError(f"{path}: names no effect ({sentence}); take physics.from out, the study is the same without")
    of_images = {name: of for name, of in effects.items() if acts_on_images(name)}
    return {name: of for name, of in effects.items() if name not in of_images}, of_images
