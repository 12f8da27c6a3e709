"""Rigid motion of the object during the scan."""

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    # About the middle of the scan, so that the mean place stays.
    moved = state.geometry.scan_fractions[:, None] * [values["x_mm"], values["y_mm"], values["z_mm"]]
    state.motion_mm = moved if state.motion_mm is None else state.motion_mm + moved


EFFECT = Effect(
    name="motion",
    physics="The object drifts steadily while it is scanned.",
    equation="place_i = place + ((i + 1/2) / N - 1/2) d: view i of N is exposed in the middle of its interval",
    source="J. Hsieh, Computed Tomography, 3rd ed., SPIE (2015), section on patient motion",
    stage="motion",
    signature="residuals at edges that grow towards the first and last views, with opposite signs",
    settled_by="the first view again at the end of the scan",
    parameters=(
        Parameter("x_mm", "mm", "drift along x over the scan", -20.0, 20.0, 0.0, 1.0),
        Parameter("y_mm", "mm", "drift along y", -20.0, 20.0, 0.0, 0.0),
        Parameter("z_mm", "mm", "drift along z", -20.0, 20.0, 0.0, 0.0),
    ),
    apply=apply,
)
