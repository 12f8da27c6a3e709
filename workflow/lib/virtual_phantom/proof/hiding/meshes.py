"""Scanned objects as triangle meshes for gVirtualXray."""

from __future__ import annotations

import numpy as np

from .objects import Part, ScannedObject

AROUND = 720  # vertices around the z axis
LEVELS = 96  # levels of an ellipsoid
HALF_MM, STEP_MM = 150.0, 10.0  # half length of long parts, which end far outside of the beam, and distance of levels


def meshes(scanned: ScannedObject) -> list[tuple[Part, np.ndarray, np.ndarray]]:
    """Return (part, vertices (n, 3) in mm, triangles (m, 3)) of all parts.

    The mesh of the outer part has the surfaces of the parts inside of it as cavities.
    """
    outer, *inner = scanned.parts
    surfaces = [surface(part) for part in scanned.parts]
    vertices, triangles = [surfaces[0][0]], [surfaces[0][1]]
    for points, faces in surfaces[1:]:
        triangles.append(faces[:, ::-1] + sum(map(len, vertices)))
        vertices.append(points)
    found = [(outer, np.concatenate(vertices), np.concatenate(triangles))]
    found += [(part, *surface) for part, surface in zip(inner, surfaces[1:], strict=True)]
    return found + [(part, *surface(part)) for part in scanned.outside]


def surface(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (mm) and triangles of a part; faces wind inwards, as gVirtualXray expects."""
    a, b, c = part.semi_axes_mm
    if c > HALF_MM:  # a truncated column or long ellipsoid
        heights = np.arange(-HALF_MM, HALF_MM + STEP_MM / 2, STEP_MM)
        widths = np.sqrt(1 - (heights / c) ** 2)
    else:
        polar = np.pi * (np.arange(LEVELS) + 0.5) / LEVELS
        heights, widths = -c * np.cos(polar), np.sin(polar)
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    # A polygon with the area of the ellipse.
    larger = np.sqrt(2 * np.pi / AROUND / np.sin(2 * np.pi / AROUND))
    u, v = (side * larger * widths[:, None] * wave for side, wave in ((a, np.cos(angle)), (b, np.sin(angle))))
    turn = np.deg2rad(part.turn_deg)
    x, y = np.cos(turn) * u - np.sin(turn) * v, np.sin(turn) * u + np.cos(turn) * v
    ends = (-c, c) if c <= HALF_MM else (heights[0], heights[-1])
    rings = np.stack(np.broadcast_arrays(x, y, heights[:, None]), axis=-1).reshape(-1, 3)
    points = np.concatenate([rings, [[0, 0, ends[0]], [0, 0, ends[1]]]]) + part.centre_mm
    here = np.arange(AROUND)
    after = (here + 1) % AROUND
    faces = []
    for level in range(len(heights) - 1):
        low, high = level * AROUND, (level + 1) * AROUND
        faces += [
            np.stack([low + here, high + after, low + after], axis=1),
            np.stack([low + here, high + here, high + after], axis=1),
        ]
    top, bottom, last = len(rings) + 1, len(rings), (len(heights) - 1) * AROUND
    faces += [np.stack([here, after, np.full(AROUND, bottom)], axis=1)]
    faces += [np.stack([last + after, last + here, np.full(AROUND, top)], axis=1)]
    return points, np.concatenate(faces)
