"""What the proof scans: two phantoms and what they are made of.

Apart from building them, which the start of the workflow would pay a second for.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Object:
    """A phantom of the suite.

    layout          file under resources
    extent_mm       (y, x) that it fills
    least_mm        height that its layout asks for, before it is cut to what the beam sees
    soft, dense     XCIST's materials: `soft`, its density following the HU, with `dense` mixed in from dense_from_hu on
    told            the same two as the diagnosis is told, in the library's names
    """

    layout: str
    extent_mm: tuple[float, float]
    least_mm: float
    soft: str
    dense: str
    dense_from_hu: float
    told: tuple[str, str]

    @property
    def stated(self) -> dict:
        """How HU are divided, as the section `materials` of the configuration."""
        soft, dense = self.told
        return {"soft": soft, "dense": dense, "dense_from_hu": self.dense_from_hu}


OBJECTS = {
    "quality_assurance": Object(
        "quality_assurance.yaml",
        (208.0, 208.0),
        40.0,
        "water",
        "ICRU_skeleton_cortical_bone_adult",
        150.0,
        ("water", "bone"),
    ),
    "abdomen": Object(
        "phantom.yaml",
        (222.0, 302.0),
        96.0,
        "ICRU_muscle_adult",
        "ICRU_skeleton_cortical_bone_adult",
        150.0,
        ("soft_tissue", "bone"),
    ),
}
