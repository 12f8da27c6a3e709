"""Objects of ellipsoids and cylinders for XCIST, which the workflow does not scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SURFACES = {"ellipsoid": 1, "cylinder": 2}  # XCIST's numbers


@dataclass(frozen=True)
class Surface:
    """An ellipsoid or an elliptic cylinder along z.

    Attributes
    ----------
    kind : {"ellipsoid", "cylinder"}
    material : str
        XCIST's name.
    centre_mm, half_axes_mm : tuple of 3 float
        Along x, y and z, mm.
    """

    kind: str
    material: str
    centre_mm: tuple[float, float, float]
    half_axes_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Surfaces:
    """An object for XCIST, given by surfaces. Later surfaces replace earlier ones where they overlap.

    At least one surface must be a cylinder: XCIST's reader fails without the planes of its ends.

    Attributes
    ----------
    rays : int, optional
        Rays per detector cell and direction.
    """

    parts: tuple[Surface, ...]
    rays: int = 2

    def configure(self, cfg, folder: Path) -> None:
        """Set the configuration to scan this object; write its file to the folder."""
        cfg.phantom.filename = str(self.write(folder))
        cfg.phantom.callback, cfg.phantom.projectorCallback = "Phantom_Analytic", "C_Projector_Analytic"
        cfg.physics.colSampleCount = cfg.physics.rowSampleCount = self.rays

    def write(self, folder: Path) -> Path:
        """Write XCIST's file, in which objects are numbered from 1."""
        names = sorted({surface.material for surface in self.parts})
        lines = [f"materialList = {{{' '.join(repr(name) for name in names)} }};"]
        for number, surface in enumerate(self.parts, start=1):
            x, y, z = surface.centre_mm
            along, across, up = surface.half_axes_mm
            lines += [
                "",
                f"object.center({number},:) = [{x:.6f} {y:.6f} {z:.6f}];",
                f"object.half_axes({number},:) = [{along:.6f} {across:.6f} {up:.6f}];",
                f"object.euler_angs({number},:) = [0.000000 0.000000 0.000000];",
                f"object.density({number}) = 1.000000;",
                f"object.type({number}) = {SURFACES[surface.kind]};",
                f"object.material({number}) = {1 + names.index(surface.material)};",
                f"object.axial_lims({number},:) = [0 0];",
                f"object.shape({number}) = 0;",
                f"object.clip{{{number}}} = [];",
            ]
        path = folder / "object.ppm"
        path.write_text("\n".join(lines) + "\n")
        return path
