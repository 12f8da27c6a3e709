"""Read and check the layout of the virtual phantom (resources/phantom.yaml): tissues, shapes and ROIs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..base.names import same_but_for_case
from ..base.streams import Stream
from ..io.yaml_files import read_yaml
from .shapes import Ellipsoid, Tube
from .texture import Component, Texture

DEFAULT_LAYOUT = RESOURCES / "phantom.yaml"
NAME = re.compile(r"[A-Za-z0-9_]+")


@dataclass(frozen=True)
class PaintedShape:
    """A shape filled with a mean HU plus a texture; it blends into the shapes below over fade_mm."""

    shape: Ellipsoid | Tube
    hu: float
    texture: Texture
    fade_mm: float


@dataclass(frozen=True)
class RoiSpec:
    """An ROI of the layout, as a shape in mm."""

    name: str
    tissue_class: str
    shape: Ellipsoid


def read_layout(path: str | Path | None = None) -> dict:
    """Read a layout file, by default DEFAULT_LAYOUT; InputError if it is missing or not YAML."""
    path = DEFAULT_LAYOUT if path is None else Path(path)
    return read_yaml(path, "give a layout of a phantom, with the keys tissues, shapes and rois", restore="restore it")


def parse_layout(layout: dict, seed: Stream) -> tuple[list[PaintedShape], list[RoiSpec]]:
    """Convert a layout to shapes in the order of painting, and to ROIs.

    The texture of each ROI has the mean and SD of its tissue inside the ROI (`Texture.condition`).

    Parameters
    ----------
    seed : Stream
        Random stream of the textures.

    Raises
    ------
    InputError
        If an entry is unknown, missing or impossible.
    """
    _keys(layout, "layout", {"tissues", "shapes", "rois"})
    if not isinstance(layout["tissues"], dict) or not layout["shapes"] or not layout["rois"]:
        raise InputError("phantom layout: needs a mapping of tissues, and lists of at least one shape and one ROI")
    for name in layout["tissues"]:
        if not isinstance(name, str):
            raise InputError(f"phantom layout, tissues: a name is {name} to YAML; write it in quotes")
    tissues = {name: _tissue(name, entry, seed) for name, entry in layout["tissues"].items()}
    paints = [
        PaintedShape(shape, *_look_up(tissues, entry, where), 0.0)
        for where, entry in _named(layout["shapes"], "shapes")
        for shape in _shapes(entry, where)
    ]
    rois: list[RoiSpec] = []
    for where, entry in _named(layout["rois"], "rois"):
        roi, surroundings = _roi(entry, where)
        for key in ("name", "tissue_class"):
            if not isinstance(entry[key], str):
                raise InputError(f"phantom layout, {where}: {key} is {entry[key]} to YAML; write the name in quotes")
        if not NAME.fullmatch(roi.name) or not NAME.fullmatch(roi.tissue_class):
            raise InputError(
                f"phantom layout, {where}: a name has other characters than letters, digits and underscores; rename it"
            )
        if roi.name in {r.name for r in rois}:
            raise InputError(f"phantom layout, {where}: the name is given twice")
        if alike := same_but_for_case([*(r.name for r in rois), roi.name]):
            raise InputError(f"phantom layout, {where}: differs from {alike[0]} only in case; rename one of them")
        rois.append(roi)
        hu, texture = _look_up(tissues, entry, where)
        texture.condition(roi.shape)
        paints.append(PaintedShape(surroundings, hu, texture, entry.get("fade_mm", 0.0)))
    return paints, rois


def _roi(entry: dict, where: str) -> tuple[RoiSpec, Ellipsoid]:
    """Return the ROI, and the larger ellipsoid of its tissue. Semi-axis c follows from the volume 4/3 pi a b c."""
    sizes = {"width_mm", "height_mm", "volume_mm3", "margin_mm"}
    _keys(entry, where, {"name", "tissue_class", "tissue", "centre_mm", *sizes}, {"fade_mm"})
    try:
        a, b = entry["width_mm"] / 2, entry["height_mm"] / 2
        semi_axes = (a, b, entry["volume_mm3"] / (4 / 3 * math.pi * a * b))
        centre = tuple(entry["centre_mm"])
        outside = entry["margin_mm"] + entry.get("fade_mm", 0.0)
        roi = RoiSpec(str(entry["name"]), str(entry["tissue_class"]), Ellipsoid(centre, semi_axes))
        return roi, Ellipsoid(centre, tuple(s + outside for s in semi_axes))
    except (TypeError, ValueError, ZeroDivisionError) as error:
        raise InputError(f"phantom layout, {where}: {error}") from None


def _tissue(name: str, entry: dict, seed: Stream) -> tuple[float, Texture]:
    where = f"tissues: {name}"
    _keys(entry, where, {"hu"}, {"texture"})
    for component in entry.get("texture", []):
        _keys(component, f"{where}: texture", {"sd_hu", "correlation_mm"}, {"skewness"})
    try:
        return float(entry["hu"]), Texture(tuple(Component(**c) for c in entry.get("texture", [])), name, seed)
    except (TypeError, ValueError) as error:
        raise InputError(f"phantom layout, {where}: {error}") from None


def _look_up(tissues: dict, entry: dict, where: str) -> tuple[float, Texture]:
    if entry.get("tissue") not in tissues:
        raise InputError(f"phantom layout, {where}: tissue {entry.get('tissue')!r} is not listed under tissues")
    return tissues[entry["tissue"]]


def _shapes(entry: dict, where: str) -> Iterator[Ellipsoid | Tube]:
    """Yield the shape of an entry, and its mirror image at x = 0 if `mirror` is true."""
    kinds = {
        "ellipsoid": (Ellipsoid, _ellipsoid),
        "column": (Ellipsoid, _column),
        "tube": (Tube, _tube),
        "arc": (Tube, _arc),
    }
    if entry.get("kind") not in kinds:
        raise InputError(f"phantom layout, {where}: kind {entry.get('kind')!r} must be one of {', '.join(kinds)}")
    kind, make = kinds[entry["kind"]]
    arguments = {k: v for k, v in entry.items() if k not in {"name", "kind", "tissue", "mirror"}}
    try:
        shape = make(**arguments)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"phantom layout, {where}: {str(error).replace('_' + entry['kind'] + '()', entry['kind'])}"
        ) from None
    yield shape
    if not isinstance(mirror := entry.get("mirror", False), bool):
        raise InputError(f"phantom layout, {where}: mirror is {mirror!r}; write true or false")
    if mirror:
        yield kind(**{f.name: _mirrored(f.name, getattr(shape, f.name)) for f in fields(shape)})


def _mirrored(name: str, value):
    if name == "centre_mm":
        return (-value[0], *value[1:])
    if name == "points_mm":
        return tuple((-x, y, z) for x, y, z in value)
    return -value if name == "rotation_deg" else value


def _ellipsoid(centre_mm, semi_axes_mm, rotation_deg=0.0):
    return Ellipsoid(tuple(centre_mm), tuple(semi_axes_mm), rotation_deg)


def _column(centre_mm, semi_axes_mm, rotation_deg=0.0, exponent=2.0):
    return Ellipsoid((*centre_mm, 0.0), (*semi_axes_mm, math.inf), rotation_deg, exponent)


def _tube(points_mm, radius_mm):
    radii = radius_mm if isinstance(radius_mm, list) else [radius_mm] * len(points_mm)
    return Tube(tuple(tuple(p) for p in points_mm), tuple(radii))


def _arc(semi_axes_mm, from_deg, to_deg, z_mm, radius_mm, centre_mm=(0.0, 0.0), exponent=2.0):
    """Return a tube along a superellipse between two angles about +z, with z rising linearly."""
    angle = np.radians(np.linspace(from_deg, to_deg, 2 + int(abs(to_deg - from_deg) // 8)))
    cos, sin = np.cos(angle), np.sin(angle)
    power = 2 / exponent
    x = centre_mm[0] + semi_axes_mm[0] * np.sign(cos) * np.abs(cos) ** power
    y = centre_mm[1] + semi_axes_mm[1] * np.sign(sin) * np.abs(sin) ** power
    points = np.column_stack([x, y, np.linspace(*z_mm, angle.size)])
    return Tube(tuple(map(tuple, points.tolist())), (float(radius_mm),) * angle.size)


def _named(entries, key: str) -> Iterator[tuple[str, dict]]:
    for number, entry in enumerate(entries or [], start=1):
        yield f"{key}: {entry.get('name', number) if isinstance(entry, dict) else number}", entry


def _keys(entry, where: str, required: set[str], optional: set[str] = frozenset()) -> None:
    if not isinstance(entry, dict):
        raise InputError(f"phantom layout, {where}: must be a mapping")
    if missing := required - entry.keys():
        raise InputError(f"phantom layout, {where}: missing {', '.join(sorted(missing))}")
    if unknown := entry.keys() - required - optional:
        raise InputError(f"phantom layout, {where}: unknown key {', '.join(sorted(map(str, unknown)))}")
