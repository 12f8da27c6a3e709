"""Objects of shapes as files say them: materials, parameters and regions by name.

A file is the user's own or one of those that come with the library (resources/objects), which say where their numbers
come from and what is not known.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ...base.data import SCHEMAS
from ...base.errors import InputError, meant
from ...base.words import same_but_for_case
from ...io.schema import fill_defaults, read_schema, validate
from ...io.yaml_files import read_yaml
from ..beam.material_names import COMPOUNDS, ELEMENTS, named
from ..beam.materials import Material, Mixture
from . import shapes
from .object_files import FOLDER, path_of
from .shapes import NOTHING, Shape

OPERATIONS: dict[type, Callable] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
LONGEST = 200  # characters of what is reckoned


@dataclass(frozen=True)
class ShapedRoi:
    """A region that is what is seen of one shape.

    Attributes
    ----------
    shape : str
        Name of the shape.
    margin_mm : float
        By which it is shrunk, mm.
    """

    name: str
    tissue_class: str
    shape: str
    margin_mm: float = 0.0


@dataclass(frozen=True)
class ShapedObject:
    """An object of shapes.

    Attributes
    ----------
    name : str
        Of the file, without its ending.
    shapes : tuple of Shape
        Later ones replace earlier ones.
    names : tuple of str or None
        Of the shapes.
    """

    name: str
    description: str
    shapes: tuple[Shape, ...]
    names: tuple[str | None, ...]
    rois: tuple[ShapedRoi, ...]


def read_object(kind: str, parameters: Mapping[str, float | str] | None = None) -> ShapedObject:
    """An object of shapes.

    Parameters
    ----------
    kind : str
        As path_of takes it.
    parameters : mapping of str to float or str, optional
        Values of those that the file has.

    Raises
    ------
    InputError
        For a file that is missing or not as its schema has it; for a parameter that is unknown, not given or no number
        where one is needed; an unknown material or shape; and for sizes that cannot be.
    """
    path = path_of(kind)
    source = str(path) if path.parent != FOLDER else f"object {path.stem}"
    content = read_yaml(path, "an object has a description and shapes (docs/how-to/objects.md)", restore="restore it")
    schema = read_schema(SCHEMAS / "object.schema.yaml")
    validate(content, schema, source)
    fill_defaults(content, schema)
    try:
        return _built(path.stem, content, dict(parameters or {}))
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def read_phantom_object(settings: Mapping) -> tuple[ShapedObject, tuple[ShapedRoi, ...]]:
    """The object of a study, and its regions.

    Parameters
    ----------
    settings : mapping
        phantom.object of the configuration.

    Raises
    ------
    InputError
        As read_object, and for a region of a shape that is not there, for one twice, or if there is none.
    """
    shaped = read_object(settings["kind"], settings.get("parameters"))
    rois = tuple(ShapedRoi(**one) for one in settings.get("rois", ())) or shaped.rois
    if not rois:
        raise InputError(f"object {shaped.name}: has no region; name some under phantom.object.rois")
    for number, roi in enumerate(rois):
        check_roi(roi, shaped.names)
        if roi.name in [one.name for one in rois[:number]]:
            raise InputError(f"phantom.object.rois: the name {roi.name} is given twice")
    if alike := same_but_for_case(roi.name for roi in rois):
        raise InputError(
            f"phantom.object.rois: the names {alike[0]} and {alike[1]} differ only in case; rename one of them"
        )
    return shaped, rois


def rois_of(settings: Mapping) -> tuple[ShapedRoi, ...]:
    """The regions alone, as read_phantom_object."""
    return read_phantom_object(settings)[1]


def _built(name: str, content: Mapping, given: Mapping[str, float | str]) -> ShapedObject:
    values = _values(content["parameters"], given)
    materials = {
        one: Mixture(
            one,
            _number(entry["density_g_per_cm3"], values, f"materials.{one}.density_g_per_cm3"),
            entry.get("compound"),
            tuple(entry.get("mass_fractions", {}).items()),
        )
        for one, entry in content["materials"].items()
    }
    made, names = [], []
    for number, entry in enumerate(content["shapes"], start=1):
        where = f"shapes: {entry.get('name', number)}"
        if entry.get("name") is not None and entry["name"] in names:
            raise InputError(f"{where}: the name is given twice")
        parts = _shapes(entry, values, materials, where)
        made += parts
        names += [entry.get("name"), *[None] * (len(parts) - 1)]
    rois = tuple(ShapedRoi(**one) for one in content.get("rois", []))
    for roi in rois:
        check_roi(roi, names)
    return ShapedObject(name, content["description"], tuple(made), tuple(names), rois)


def check_roi(roi: ShapedRoi, names) -> None:
    """Check that a region's shape is there.

    Raises
    ------
    InputError
        If it is not.
    """
    known = [name for name in names if name is not None]
    if roi.shape not in known:
        raise InputError(
            f"rois: {roi.name} names the shape '{roi.shape}', which is not there; {meant(roi.shape, known)}"
        )


def _values(parameters: Mapping, given: Mapping[str, float | str]) -> dict[str, float | str]:
    for name in given:
        if name not in parameters:
            raise InputError(
                f"there is no parameter '{name}'; {meant(name, parameters) if parameters else 'it has none'}"
            )
    missing = [name for name, entry in parameters.items() if name not in given and "default" not in entry]
    if missing:
        wanted = "; ".join(f"{name} ({parameters[name]['description'].rstrip('.')})" for name in missing)
        raise InputError(f"needs the parameters {wanted}")
    return {name: given.get(name, entry.get("default")) for name, entry in parameters.items()}


def _shapes(entry: Mapping, values: Mapping, materials: Mapping[str, Mixture], where: str) -> list[Shape]:
    """The convex shapes of an entry, the one that bears its name first."""

    def number(key: str, default: float | None = None) -> float | None:
        return _number(entry[key], values, f"{where}: {key}") if key in entry else default

    def vector(key: str, default: tuple | None = None) -> tuple[float, ...]:
        return tuple(_number(one, values, f"{where}: {key}") for one in entry[key]) if key in entry else default

    def centre() -> tuple[float, ...]:
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
                return [shapes.cylinder(material(), centre(), number("diameter_mm") / 2, number("length_mm"), along)]
            case "tube":
                inner, outer = number("inner_diameter_mm") / 2, number("outer_diameter_mm") / 2
                if not inner < outer:
                    raise InputError("inner_diameter_mm must be less than outer_diameter_mm")
                ends = number("length_mm"), along
                inside = shapes.cylinder(material("inside"), centre(), inner, *ends)
                return [shapes.cylinder(material(), centre(), outer, *ends), inside]
            case "ball":
                return [shapes.ellipsoid(material(), centre(), 3 * (number("diameter_mm") / 2,))]
            case "ellipsoid":
                return [shapes.ellipsoid(material(), centre(), vector("semi_axes_mm"), number("turn_deg", 0.0))]
            case "box":
                return [shapes.box(material(), centre(), vector("sides_mm"), number("turn_deg", 0.0))]
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
    if name == NOTHING or named(name) in (*COMPOUNDS, *ELEMENTS):
        return named(name)
    known = [*materials, *COMPOUNDS, *ELEMENTS, NOTHING]
    raise InputError(f"{where}: material '{name}' is unknown; {meant(name, known)}")


def _number(value: float | str, values: Mapping[str, float | str], where: str) -> float:
    """A number, or what is reckoned from parameters."""
    if not isinstance(value, str):
        return float(value)
    try:
        if len(value) > LONGEST:
            raise SyntaxError
        found = _reckoned(ast.parse(value, mode="eval").body, values)
    except (SyntaxError, KeyError, TypeError, ValueError, ZeroDivisionError, RecursionError):
        known = ", ".join(values) or "none"
        raise InputError(
            f"{where}: '{value}' is no number; write one, or + - * / of numbers and parameters (there are: {known})"
        ) from None
    if not math.isfinite(found):
        raise InputError(f"{where}: '{value}' is {found}; give parameters that make it a number")
    return found


def _reckoned(node: ast.AST, values: Mapping[str, float | str]) -> float:
    match node:
        case ast.BinOp():
            return OPERATIONS[type(node.op)](_reckoned(node.left, values), _reckoned(node.right, values))
        case ast.UnaryOp(op=ast.USub()):
            return -_reckoned(node.operand, values)
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.Name():
            return float(values[node.id])
    raise SyntaxError
