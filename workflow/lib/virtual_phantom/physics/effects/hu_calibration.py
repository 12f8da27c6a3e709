"""HU calibration: scale and offset."""

from ..effect import Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Scale and shift the HU values."""
    state.hu = state.hu * values["scale"] + values["offset_hu"]


EFFECT = Effect(
    name="hu_calibration",
    physics="The water and air values of the scanner are miscalibrated.",
    equation="HU' = a HU + b",
    source="IEC 61223-3-5:2019 (CT numbers)",
    stage="image",
    signature="means of all regions are shifted equally, or in proportion to their HU",
    settled_by="scan a water phantom with surrounding air",
    parameters=(
        Parameter("scale", "1", "a: factor of HU", 0.5, 1.5, 1.0, 1.02, 1.0),
        Parameter("offset_hu", "HU", "b: added to HU", -500.0, 500.0, 0.0, 5.0),
    ),
    apply=apply,
    rank=1,
)
