"""Rings in images."""

from ...base.streams import Branch, branch, generator
from ..effect import Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Add rings that are as wide as a pixel."""
    if not values["rms"]:
        return
    rings = state.rings
    for index, image in enumerate(state.hu):
        stream = branch(0, Branch.RINGS, int(values["pattern"]), index)
        amounts = values["rms"] * generator(stream).normal(size=rings.max() + 1)
        state.hu[index] = image + amounts[rings].astype(state.hu.dtype)


EFFECT = Effect(
    name="rings",
    physics="Gains of detector elements have drifted since the air scan. Each error makes a ring about the isocenter, "
    "another one in each slice.",
    equation="HU' = HU + g(r, z), g normal with standard deviation s, one value for each slice and each pixel of r",
    source="J. Sijbers and A. Postnov, Phys. Med. Biol. 49, N247 (2004)",
    stage="image",
    signature="HU change from one distance from the isocenter to the next, equally in all directions",
    settled_by="make an air scan immediately before or after the scan",
    parameters=(
        Parameter("rms", "HU", "s: standard deviation of the rings", 0.0, 200.0, 1.0, 3.0),
        Parameter("pattern", "number", "number of the random pattern", 0.0, 1e6, 0.0, 0.0, None),
    ),
    apply=apply,
    of_one_scan=True,
    removed_by=("gain", "flat"),
    pattern=True,
    rank=-1,
)
