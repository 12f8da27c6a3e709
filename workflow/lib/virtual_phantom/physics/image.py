"""The last stage of the chain: effects that act on reconstructed images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .effect import image_effects, load


@dataclass
class ImageState:
    """What effects change: HU [z, y, x], float, and the voxels (z, y, x), mm, that they go by."""

    hu: np.ndarray
    spacing_mm: tuple[float, float, float]


def with_effects(hu: np.ndarray, spacing_mm: tuple[float, float, float], physics: Mapping[str, Mapping[str, float]]):
    """An image [z, y, x] in HU after effects of stage "image", {effect: {parameter: value}}; without any, itself."""
    if not physics:
        return hu
    state = ImageState(np.asarray(hu, np.float32), spacing_mm)
    for name in sorted(physics, key=image_effects().index):
        load(name).apply(state, physics[name])
    return state.hu
