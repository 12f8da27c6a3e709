"""Rotation during a view."""

import math

from ...base.geometry import orbit_of
from ..effect import CLOSE_VIEWS, Effect, Parameter
from ..scenes.sampling import points
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the moments of a view at which rays are traced."""
    geometry, duty = orbit_of(state.geometry, "view_blur"), values["duty"]
    # Blur at the edge of the field of view, in pixels at the isocenter.
    arc_rad = 2 * math.pi / geometry.views_per_rotation / geometry.views_apart
    pixel_mm = geometry.column_pitch_mm / geometry.magnification
    blurred = duty * arc_rad * geometry.field_of_view_radius_mm / pixel_mm
    state.turns = tuple((duty * place, weight) for place, weight in points(duty, blurred, state.fewest_points))


EFFECT = Effect(
    name="view_blur",
    physics="Source and detector rotate during the exposure of a view.",
    equation="T_i = mean of the transmissions T over the time from -q dt / 2 to q dt / 2 around the middle of view i",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), azimuthal blurring",
    stage="geometry",
    signature="edges are blurred along the columns, more so far from the axis; edges that move along the ray are not",
    settled_by="repeat the scan with more views per turn, or scan a wire at two distances from the axis",
    parameters=(
        Parameter("duty", "1", "q: exposed share of the view interval", 0.0, 1.0, 0.5, 1.0, power=2, fraction=True),
    ),
    needs=(CLOSE_VIEWS,),
    apply=apply,
)
