"""Scanned objects: bodies, quality-assurance phantoms and discs, drawn at random for every case.

An object consists of ellipsoids and elliptic columns along z, described once. `xcist_surfaces` and `meshes` make the
scanned object for the two simulators, `stated_object` the description that the diagnosis gets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...base.pose import Pose
from .materials import IN_LIBRARY, MATERIALS, Attenuation, tissue

BODY, PHANTOM, BENCH = KINDS = ("body", "quality_assurance", "bench")
HU, SHAPES, LABELS, DISC = "hu", "shapes", "labels", "disc"
# Descriptions that the diagnosis gets, in turn: a CT in HU, shapes, a label map, a disc.
DESCRIPTIONS = {BODY: (HU,), PHANTOM: (SHAPES, LABELS), BENCH: (DISC, SHAPES, LABELS)}
# Source to isocenter and to detector, mm.
DISTANCES_MM = {BODY: (541.0, 949.0), PHANTOM: (541.0, 949.0), BENCH: (400.0, 560.0)}
GAP_MM = 2.5  # between parts, and from parts to the surface: more than all errors of shape
ATTEMPTS = 200  # to place a part
LONG_MM = 600.0  # semi-axis of the body along z
ROOM = 1.06  # width of the beam over the width of the object


@dataclass(frozen=True)
class Part:
    """An ellipsoid, or an elliptic column along z (the third semi-axis is infinite).

    Attributes
    ----------
    material : str
        Name in MATERIALS; empty: a tissue of the CT number `hu`.
    density : float
        Relative to the density of the material.
    """

    name: str
    centre_mm: tuple[float, float, float]
    semi_axes_mm: tuple[float, float, float]
    turn_deg: float = 0.0
    material: str = ""
    hu: float = 0.0
    density: float = 1.0

    @property
    def shape(self):
        """Surface of the part, a phantom.shapes.Ellipsoid."""
        from ...phantom.shapes import Ellipsoid  # slow import, which the start of the workflow does not need

        return Ellipsoid(self.centre_mm, self.semi_axes_mm, self.turn_deg)

    @property
    def radius_mm(self) -> float:
        """Largest semi-axis in the plane, mm."""
        return max(self.semi_axes_mm[:2])

    def amounts(self, attenuation: Attenuation, mu_water_per_mm: float) -> dict[str, float]:
        """Return {material: volume fraction times relative density}; empty for air."""
        if self.material == "air":
            return {}
        made = {self.material: 1.0} if self.material else tissue(self.hu, attenuation, mu_water_per_mm)
        return {name: amount * self.density for name, amount in made.items()}

    def attenuation_per_mm(self, attenuation: Attenuation, mu_water_per_mm: float) -> float:
        """Return the attenuation at the energy of the monochromatic beam, 1/mm."""
        amounts = self.amounts(attenuation, mu_water_per_mm)
        return sum(amount * attenuation(name) for name, amount in amounts.items())


@dataclass(frozen=True)
class ScannedObject:
    """An object. The first part contains some of the others; those and the parts outside of it do not overlap.

    Attributes
    ----------
    outside : tuple of Part
        Parts outside of the first one.
    """

    kind: str
    parts: tuple[Part, ...]
    outside: tuple[Part, ...] = ()

    @property
    def label_materials(self) -> dict[str, str | dict]:
        """Material of every label of a label map, as given to the diagnosis."""
        return {str(number): _stated(part.material) for number, part in enumerate(self.parts, start=1)}

    @property
    def radius_mm(self) -> float:
        """Radius of the first part about the z axis, mm."""
        return self.parts[0].radius_mm

    def pixel_mm(self, columns: int) -> float:
        """Return the width of a detector pixel at the isocenter for a beam that covers the stated object."""
        return 2 * self.radius_mm * ROOM / columns


def _stated(material: str) -> str | dict:
    if material == "air":
        return "nothing"
    return material if material in IN_LIBRARY else MATERIALS[material].stated()


def drawn_object(kind: str, homogeneous: bool, random: np.random.Generator) -> ScannedObject:
    """Draw an object of KINDS. A homogeneous bench object has no inserts."""
    if kind == BODY:
        return ScannedObject(kind, _placed(*_body(random), random))
    if kind == PHANTOM:
        return ScannedObject(kind, _placed(*_phantom(random), random))
    return ScannedObject(kind, _placed(*_bench(homogeneous, random), random))


def _body(random):
    axes = float(random.uniform(110, 145)), float(random.uniform(85, 108)), LONG_MM
    outer = Part("body", (0.0, 0.0, 0.0), axes, float(random.uniform(-10, 10)), hu=float(random.uniform(20, 60)))
    wanted = [("spine", random.uniform(300, 900), random.uniform(13, 20))]
    wanted += [("rib", random.uniform(500, 1100), random.uniform(4, 7)), ("gas", -1000.0, random.uniform(6, 12))]
    kinds = [("fat", (-120, -70)), ("fluid", (-5, 15)), ("organ", (65, 110)), ("lesion", (70, 140))]
    for name, (low, high) in kinds[: int(random.integers(2, 5))]:
        wanted.append((name, random.uniform(low, high), random.uniform(10, 32)))
    parts = []
    for name, hu, size in wanted:
        long = random.uniform(0.8, 2.0) * size if name in ("gas", "organ", "lesion") else np.inf
        axes = float(size), float(size * random.uniform(0.6, 1.0)), float(long)
        material = "air" if name == "gas" else ""
        parts.append(Part(name, (0, 0, 0), axes, float(random.uniform(0, 180)), material, float(hu)))
    return outer, parts


def _phantom(random):
    radius = float(random.uniform(80, 110))
    outer = Part("body", (0.0, 0.0, 0.0), (radius, radius, np.inf), material=str(random.choice(["water", "pmma"])))
    materials = [name for name in ("air", *MATERIALS) if name not in (outer.material, "bone")]
    chosen = random.permutation(materials)[: int(random.integers(4, 7))]
    sizes = {"aluminium": (4, 7), "teflon": (5, 9)}
    parts = [_rod(str(name), random.uniform(*sizes.get(name, (7, 15)))) for name in chosen]
    ball = float(random.uniform(5, 9))
    return outer, [*parts, Part("ball", (0, 0, 0), (ball, ball, ball), material="teflon")]


def _bench(homogeneous, random):
    radius = float(random.uniform(30, 45))
    outer = Part(
        "body", (0.0, 0.0, 0.0), (radius, radius, np.inf), material=str(random.choice(["pmma", "polyethylene"]))
    )
    materials = ["air", "aluminium", "delrin", "teflon"]
    chosen = [] if homogeneous else random.permutation(materials)[: int(random.integers(1, 4))]
    return outer, [_rod(str(name), random.uniform(2, 3.5 if name == "aluminium" else 8)) for name in chosen]


def _rod(name: str, radius: float) -> Part:
    return Part(name, (0, 0, 0), (float(radius), float(radius), np.inf), material=name)


def _placed(outer: Part, parts: list[Part], random: np.random.Generator) -> tuple[Part, ...]:
    """Place parts inside the outer one at random, without overlap. A part that does not fit is omitted."""
    placed: list[Part] = []
    for part in parts:
        for _ in range(ATTEMPTS):
            x, y = (float(random.uniform(-1, 1)) * outer.radius_mm for _ in range(2))
            radius = part.radius_mm + GAP_MM
            apart = all(np.hypot(x - p.centre_mm[0], y - p.centre_mm[1]) > radius + p.radius_mm for p in placed)
            if apart and float(outer.shape.level(0.0, y, x)) < -radius:
                z = float(random.uniform(-2, 2)) if np.isfinite(part.semi_axes_mm[2]) else 0.0
                placed.append(replace(part, centre_mm=(x, y, z)))
                break
    return (outer, *placed)


def imperfect(
    scanned: ScannedObject, errors: Mapping, attenuation: Attenuation, mu_water_per_mm: float
) -> ScannedObject:
    """Return the object with errors of CT numbers, sizes and pose (`imperfections.drawn`)."""
    pose = Pose(**errors["pose"])
    parts = [_wrong(part, errors, attenuation, mu_water_per_mm) for part in scanned.parts]
    return replace(scanned, parts=tuple(_moved(part, pose) for part in parts))


def _wrong(part: Part, errors: Mapping, attenuation: Attenuation, mu_water_per_mm: float) -> Part:
    grown = tuple(side + errors["shape_mm"].get(part.name, 0.0) for side in part.semi_axes_mm)
    mu, hu = part.attenuation_per_mm(attenuation, mu_water_per_mm), errors["object"].get(part.name, 0.0)
    density = 1 + mu_water_per_mm * hu / 1000 / mu if mu else 1.0
    return replace(part, semi_axes_mm=grown, density=part.density * density)


def _moved(part: Part, pose: Pose) -> Part:
    x, y, z = part.centre_mm
    cosine, sine = np.cos(np.deg2rad(pose.turn_deg)), np.sin(np.deg2rad(pose.turn_deg))
    center = cosine * x - sine * y + pose.x_mm, sine * x + cosine * y + pose.y_mm, z + pose.z_mm
    return replace(part, centre_mm=tuple(map(float, center)), turn_deg=part.turn_deg + pose.turn_deg)
