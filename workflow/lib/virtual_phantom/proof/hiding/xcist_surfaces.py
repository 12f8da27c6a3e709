"""Objects of ellipsoids and cylinders for XCIST's analytic projector, whose edges are exact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from .materials import Attenuation, Material, mixed
from .objects import ScannedObject
from .xcist import HOOKS, write_material

ELLIPSOID, CYLINDER = 1, 2  # XCIST's numbers
FAR_MM = 5000.0  # half length of columns that are infinitely long


@dataclass(frozen=True)
class Surface:
    """An ellipsoid or an elliptic cylinder along z.

    Attributes
    ----------
    kind : int
        ELLIPSOID or CYLINDER.
    material : str
        XCIST's name, or one of `Surfaces.composed`.
    centre_mm, half_axes_mm : tuple of 3 float
        Along x, y and z, mm.
    density : float
        Relative to the density of the material.
    turn_deg : float
        Rotation about z.
    """

    kind: int
    material: str
    centre_mm: tuple[float, float, float]
    half_axes_mm: tuple[float, float, float]
    density: float = 1.0
    turn_deg: float = 0.0


@dataclass(frozen=True)
class Surfaces:
    """An object for XCIST, given by surfaces. Later surfaces replace earlier ones where they overlap.

    At least one surface must be a cylinder: XCIST's reader fails without the planes of its ends.

    Attributes
    ----------
    composed : mapping of str to Material
        Materials that are not XCIST's, by name.
    """

    parts: tuple[Surface, ...]
    composed: Mapping[str, Material] = field(default_factory=dict)
    # Chi-square of edges in columns of 3.6 mm, with 4 x 10^5 photons: 614 with 8 x 2, 13 with 32 x 2, 4 from rounding.
    cells_divided: tuple[int, int] = (32, 2)

    @classmethod
    def of(cls, scanned: ScannedObject, attenuation: Attenuation, mu_water_per_mm: float) -> Surfaces:
        """Return the surfaces of an object of the blind validation."""
        surfaces, composed = [], {}
        for number, part in enumerate((*scanned.outside, *scanned.parts)):
            amounts = part.amounts(attenuation, mu_water_per_mm)
            name = f"part{number}" if amounts else "air"
            if amounts:
                composed[name] = mixed(amounts)
            *plane, up = part.semi_axes_mm
            kind, axes = (CYLINDER, (*plane, FAR_MM)) if np.isinf(up) else (ELLIPSOID, part.semi_axes_mm)
            surfaces.append(Surface(kind, name, part.centre_mm, axes, float(bool(amounts)), part.turn_deg))
        return cls(tuple(surfaces), composed)

    def configure(self, cfg, folder: Path) -> None:
        """Set the configuration to scan this object; write its files to the folder."""
        if any(sign.isspace() or sign == "=" for sign in str(folder)):
            raise InputError(f"{folder}: XCIST reads no folder with a space or = in its path; set TMPDIR to another")
        cfg.phantom.filename = str(self.write(folder))
        cfg.phantom.callback, cfg.phantom.projectorCallback = "Phantom_Analytic", HOOKS + "projector"
        cfg.physics.colSampleCount = cfg.physics.rowSampleCount = 1

    def write(self, folder: Path) -> Path:
        """Write XCIST's files, in which objects are numbered from 1."""
        names = sorted({surface.material for surface in self.parts})
        known = [write_material(name, self.composed[name], folder) if name in self.composed else name for name in names]
        lines = [f"materialList = {{{' '.join(map(repr, known))} }};"]
        for number, surface in enumerate(self.parts, start=1):
            x, y, z = surface.centre_mm
            along, across, up = surface.half_axes_mm
            lines += [
                "",
                f"object.center({number},:) = [{x:.9f} {y:.9f} {z:.9f}];",
                f"object.half_axes({number},:) = [{along:.9f} {across:.9f} {up:.9f}];",
                f"object.euler_angs({number},:) = [{surface.turn_deg:.9f} 0.000000 0.000000];",
                f"object.density({number}) = {surface.density:.9f};",
                f"object.type({number}) = {surface.kind};",
                f"object.material({number}) = {1 + names.index(surface.material)};",
                f"object.axial_lims({number},:) = [0 0];",
                f"object.shape({number}) = 0;",
                f"object.clip{{{number}}} = [];",
            ]
        path = folder / "object.ppm"
        path.write_text("\n".join(lines) + "\n")
        return path
