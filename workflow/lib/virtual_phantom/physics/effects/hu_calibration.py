"""HU calibration: scale and offset."""

from ..effect import Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Scale and shift the HU."""
    state.hu = state.hu * values["scale"] + values["offset_hu"]


EFFECT = Effect(
    name="hu_calibration",
    physics="The scanner's water and air values are off.",
    equation="HU' = a HU + b",
    source="IEC 61223-3-5:2019 (CT numbers)",
    stage="image",
    signature="means of all regions shifted alike, or in proportion to their HU",
    settled_by="a water phantom and the air around it",
    parameters=(
        Parameter("scale", "1", "factor of HU", 0.8, 1.2, 1.0, 1.02, 1.0),
        Parameter("offset_hu", "HU", "added to HU", -100.0, 100.0, 0.0, 5.0),
    ),
    apply=apply,
    rank=1,
)
