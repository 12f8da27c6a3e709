"""Objects of shapes from YAML files: materials, parameters and regions by name.

Files are the user's, or those of the library (resources/objects), which state the sources of their numbers.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ...base.data import SCHEMAS
from ...base.errors import InputError, did_you_mean, naming
from ...base.names import same_but_for_case
from ...base.settings import ShapedRoi, ShapesPhantom
from ...io.schema import fill_defaults, read_schema, validate
from ...io.yaml_files import read_yaml
from ..beam.material_names import COMPOUNDS, ELEMENTS, library_name
from ..beam.materials import Material, Mixture
from . import shapes
from .object_files import FOLDER, object_path
from .shapes import NOTHING, Shape

OPERATIONS: dict[type, Callable] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
MAX_EXPRESSION = 200  # characters


@dataclass(frozen=True)
class ShapedObject:
    """An object of shapes.

    Attributes
    ----------
    name : str
        Name of the file without extension.
    shapes : tuple of Shape
        Later shapes replace earlier ones where they overlap.
    """

    name: str
    description: str
    shapes: tuple[Shape, ...]
    names: tuple[str | None, ...]
    rois: tuple[ShapedRoi, ...]


def read_object(kind: str, parameters: Mapping[str, float | str] | None = None) -> ShapedObject:
    """Read an object of shapes.

    Parameters
    ----------
    kind : str
        As object_path takes it.
    parameters : mapping of str to float or str, optional
        Values of the parameters in the file.

    Raises
    ------
    InputError
        If the file is missing or breaks its schema; if a parameter is unknown, missing or not a number; for an unknown
        material or shape; and for invalid sizes.
    """
    path = object_path(kind)
    source = str(path) if path.parent != FOLDER else f"object {path.stem}"
    content = read_yaml(path, "an object has a description and shapes (docs/how-to/objects.md)", restore="restore it")
    schema = read_schema(SCHEMAS / "object.schema.yaml")
    validate(content, schema, source)
    fill_defaults(content, schema)
    with naming(source):
        return _object(path.stem, content, dict(parameters or {}))


def read_phantom_object(settings: ShapesPhantom) -> tuple[ShapedObject, tuple[ShapedRoi, ...]]:
    """Read the object of a study and its regions.

    Raises
    ------
    InputError
        As read_object; if there is no region, or a region has an unknown shape or a repeated name.
    """
    shaped = read_object(settings.kind, settings.parameters)
    rois = settings.rois or shaped.rois
    if not rois:
        raise InputError(f"object {shaped.name}: has no region; name some under phantom.object.rois")
    names = [roi.name for roi in rois]
    for number, roi in enumerate(rois):
        _check_roi(roi, shaped.names)
        if roi.name in names[:number]:
            raise InputError(f"phantom.object.rois: the name {roi.name} is given twice")
    if alike := same_but_for_case(names):
        raise InputError(
            f"phantom.object.rois: the names {alike[0]} and {alike[1]} differ only in case; rename one of them"
        )
    return shaped, rois


def _object(name: str, content: Mapping, given: Mapping[str, float | str]) -> ShapedObject:
    values = _values(content["parameters"], given)
    materials = {
        material: Mixture(
            material,
            _number(entry["density_g_per_cm3"], values, f"materials.{material}.density_g_per_cm3"),
            entry.get("compound"),
            tuple(entry.get("mass_fractions", {}).items()),
        )
        for material, entry in content["materials"].items()
    }
    parts, names = [], []
    for number, entry in enumerate(content["shapes"], start=1):
        where = f"shapes: {entry.get('name', number)}"
        if entry.get("name") is not None and entry["name"] in names:
            raise InputError(f"{where}: the name is given twice")
        convex = _shapes(entry, values, materials, where)
        parts += convex
        names += [entry.get("name"), *[None] * (len(convex) - 1)]
    rois = tuple(ShapedRoi(**entry) for entry in content.get("rois", []))
    for roi in rois:
        _check_roi(roi, names)
    return ShapedObject(name, content["description"], tuple(parts), tuple(names), rois)


def _check_roi(roi: ShapedRoi, names) -> None:
    known = [name for name in names if name is not None]
    if roi.shape not in known:
        raise InputError(
            f"rois: {roi.name} names the shape '{roi.shape}', which does not exist; {did_you_mean(roi.shape, known)}"
        )


def _values(parameters: Mapping, given: Mapping[str, float | str]) -> dict[str, float | str]:
    for name in given:
        if name not in parameters:
            raise InputError(
                f"there is no parameter '{name}'; {did_you_mean(name, parameters) if parameters else 'it has none'}"
            )
    missing = [name for name, entry in parameters.items() if name not in given and "default" not in entry]
    if missing:
        described = "; ".join(f"{name} ({parameters[name]['description'].rstrip('.')})" for name in missing)
        raise InputError(f"needs the parameters {described}")
    return {name: given.get(name, entry.get("default")) for name, entry in parameters.items()}


def _shapes(entry: Mapping, values: Mapping, materials: Mapping[str, Mixture], where: str) -> list[Shape]:
    """Return the convex shapes of an entry; the first one has the name of the entry."""

    def number(key: str, default: float | None = None) -> float | None:
        return _number(entry[key], values, f"{where}: {key}") if key in entry else default

    def vector(key: str, default: tuple | None = None) -> tuple[float, ...]:
        return tuple(_number(part, values, f"{where}: {key}") for part in entry[key]) if key in entry else default

    def center() -> tuple[float, ...]:
        polar = {"distance_mm", "angle_deg", "z_mm"} & set(entry)
        if "centre_mm" in entry and polar:
            raise InputError(f"{where}: has both centre_mm and {', '.join(sorted(polar))}; keep one of them")
        distance, angle = number("distance_mm", 0.0), math.radians(number("angle_deg", 0.0))
        return vector("centre_mm", (distance * math.cos(angle), distance * math.sin(angle), number("z_mm", 0.0)))

    def material(key: str = "material") -> Material:
        return _material(entry[key], values, materials, where)

    along = vector("axis", (0.0, 0.0, 1.0))
    try:
        match entry["kind"]:
            case "cylinder":
                return [shapes.cylinder(material(), center(), number("diameter_mm") / 2, number("length_mm"), along)]
            case "tube":
                inner, outer = number("inner_diameter_mm") / 2, number("outer_diameter_mm") / 2
                if not inner < outer:
                    raise InputError("inner_diameter_mm must be less than outer_diameter_mm")
                ends = number("length_mm"), along
                inside = shapes.cylinder(material("inside"), center(), inner, *ends)
                return [shapes.cylinder(material(), center(), outer, *ends), inside]
            case "ball":
                return [shapes.ellipsoid(material(), center(), 3 * (number("diameter_mm") / 2,))]
            case "ellipsoid":
                return [shapes.ellipsoid(material(), center(), vector("semi_axes_mm"), number("turn_deg", 0.0))]
            case "box":
                return [shapes.box(material(), center(), vector("sides_mm"), number("turn_deg", 0.0))]
            case "cone":
                radii = number("base_diameter_mm") / 2, number("top_diameter_mm", 0.0) / 2
                return [shapes.cone(material(), vector("base_mm"), *radii, number("height_mm"), along)]
            case _:
                return [shapes.half_space(material(), vector("point_mm"), vector("outwards"))]
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def _material(name: str, values: Mapping, materials: Mapping[str, Mixture], where: str) -> Material:
    name = str(values.get(name, name))
    if name in materials:
        return materials[name]
    if name == NOTHING or library_name(name) in (*COMPOUNDS, *ELEMENTS):
        return library_name(name)
    known = [*materials, *COMPOUNDS, *ELEMENTS, NOTHING]
    raise InputError(f"{where}: material '{name}' is unknown; {did_you_mean(name, known)}")


def _number(value: float | str, values: Mapping[str, float | str], where: str) -> float:
    """Return a number, or the value of an arithmetic expression of parameters."""
    if not isinstance(value, str):
        return float(value)
    try:
        if len(value) > MAX_EXPRESSION:
            raise SyntaxError
        found = _evaluate(ast.parse(value, mode="eval").body, values)
    except (SyntaxError, KeyError, TypeError, ValueError, ZeroDivisionError, RecursionError):
        known = ", ".join(values) or "none"
        raise InputError(
            f"{where}: '{value}' is not a number; use a number, or + - * / of numbers and parameters ({known})"
        ) from None
    if not math.isfinite(found):
        raise InputError(f"{where}: '{value}' is {found}; give parameters that make it a number")
    return found


def _evaluate(node: ast.AST, values: Mapping[str, float | str]) -> float:
    match node:
        case ast.BinOp():
            return OPERATIONS[type(node.op)](_evaluate(node.left, values), _evaluate(node.right, values))
        case ast.UnaryOp(op=ast.USub()):
            return -_evaluate(node.operand, values)
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.Name():
            return float(values[node.id])
    raise SyntaxError
