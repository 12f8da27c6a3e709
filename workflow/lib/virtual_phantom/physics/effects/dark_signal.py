"""Dark signal that was not subtracted, and its drift."""

from ..chain import State
from ..effect import Effect, Parameter


def apply(state: State, values: dict[str, float]) -> None:
    time = state.geometry.scan_fractions[:, None, None]
    state.dark, state.dark_air = values["level"] + values["drift"] * time, values["level"]


EFFECT = Effect(
    name="dark_signal",
    physics="The detector reads a signal without radiation that differs from the one subtracted, and that drifts as it "
    "warms up.",
    equation="S_i' = S_i + d + r ((i + 1/2) / N - 1/2), S_air' = S_air + d, in units of the signal in air; "
    "view i of N is exposed in the middle of its interval",
    source="J. H. Siewerdsen and D. A. Jaffray, Med. Phys. 26, 1624 (1999)",
    stage="readout",
    signature="line integrals too low where little is transmitted, alike in all columns; with a drift, more from view "
    "to view",
    settled_by="dark frames before and after the scan",
    parameters=(
        Parameter("level", "1", "dark signal left over, over the signal in air", -0.02, 0.1, 0.001, 0.005),
        Parameter("drift", "1", "its change over the scan, over the signal in air", -0.02, 0.02, 0.0005, 0.001),
    ),
    apply=apply,
)
