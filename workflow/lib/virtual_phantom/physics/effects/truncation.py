"""Truncated projections: the object extends beyond the field of view."""

import numpy as np

from ..effect import LOGARITHM, Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Add the shading of a truncated water disc inside the field of view."""
    fov, half = values["radius_mm"], values["path_mm"] / 2
    pixel = min(state.spacing_mm[1:])
    inner = np.minimum(state.radius_mm, fov - pixel / 2)
    disc = fov**2 + half**2  # square of the disc's radius: its chord at the edge of the field of view is 2 half
    rest = disc - inner**2
    lost = np.pi / 2 - np.arcsin(np.clip(1 - 2 * half**2 / rest, -1, 1))
    change = 1000 / np.pi * (2 * half / np.sqrt(fov**2 - inner**2) - lost)
    state.hu = state.hu + np.where(state.radius_mm < fov, change, 0).astype(state.hu.dtype)


EFFECT = Effect(
    name="truncation",
    physics="The object extends beyond the field of view, and the reconstruction takes missing rays for air. HU rise "
    "toward the edge of the field of view.",
    equation="HU' = HU + 1000 / pi (L / sqrt(S^2 - r^2) - pi/2 + arcsin(1 - L^2 / 2 / (S^2 + L^2 / 4 - r^2))) at r < S",
    source="B. Ohnesorge et al., Med. Phys. 27, 39 (2000); equation: back-projection of a truncated water disc",
    stage="image",
    signature="HU rise steeply toward a circle about the isocenter, equally in all directions",
    settled_by="center the object, or scan a smaller one",
    parameters=(
        Parameter("path_mm", "mm", "L: water in the rays at the edge of the field of view", 0.0, 300.0, 20.0, 20.0),
        Parameter(
            "radius_mm",
            "mm",
            "S: radius of the field of view",
            20.0,
            400.0,
            150.0,
            150.0,
            None,
            LOGARITHM,
            field_of_view=True,
        ),
    ),
    apply=apply,
    rank=-1,
)
