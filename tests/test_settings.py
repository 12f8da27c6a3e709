"""Dataclasses of settings: the same keys as the JSON schema, and a conversion that loses nothing."""

import typing
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path

import pytest
from workflow_runs import BENEATH

from virtual_phantom.base.settings import FbpSettings, from_mapping, to_mapping
from virtual_phantom.config.config import complete
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.config.settings import Analyses, Comparison, NoiseLevel, Protocol, Study
from virtual_phantom.diagnosis.settings import (
    LabelledObject,
    MaskedObject,
    OtherScan,
    RecordingSettings,
    ShapesObject,
    UnknownObject,
)
from virtual_phantom.io.schema import SCHEMA, read_schema

ROOT = Path(__file__).resolve().parents[1]
# Keys that the library adds, and keys that it replaces by others.
ADDED = {Protocol: {"image_physics", "physics_from"}, FbpSettings: {"kernel", "noise_kernel"}}
REPLACED = {Comparison: {"attribute"}, NoiseLevel: {"photons"}}


def dataclasses_of(hint):
    """The dataclasses inside a type, such as those of dict[str, X | None]."""
    if is_dataclass(hint):
        return [hint]
    return [found for argument in typing.get_args(hint) for found in dataclasses_of(argument)]


def section_of(schema):
    """The schema of a section, or of one entry if the section holds several."""
    if "$ref" in schema:
        schema = read_schema(SCHEMA)["$defs"][schema["$ref"].rpartition("/")[2]] | schema
    if "properties" in schema:
        return schema
    return section_of(schema["items"] if "items" in schema else schema["additionalProperties"])


def sections(kind=Study, schema=None):
    schema = read_schema(SCHEMA) if schema is None else schema
    yield kind, schema
    for name, hint in typing.get_type_hints(kind).items():
        inner = dataclasses_of(hint)
        if len(inner) == 1 and name not in ADDED.get(kind, ()):
            yield from sections(inner[0], section_of(schema["properties"][name]))


SECTIONS = dict(sections())


def test_sections_are_found():
    assert len(SECTIONS) > 35


@pytest.mark.parametrize("kind", SECTIONS, ids=lambda kind: kind.__name__)
def test_a_section_has_the_keys_of_its_schema(kind):
    known = set(SECTIONS[kind]["properties"]) | ADDED.get(kind, set())
    assert {one.name for one in fields(kind)} == known - REPLACED.get(kind, set())


@pytest.mark.parametrize("kind", [kind for kind in SECTIONS if kind != Analyses], ids=lambda kind: kind.__name__)
def test_none_is_the_default_of_keys_that_may_be_absent(kind):
    schema = SECTIONS[kind]
    required = set(read_schema(SCHEMA)["properties"]["scan"]["required"]) | set(schema.get("required", ()))
    for one in fields(kind):
        stated = schema["properties"].get(one.name, {})
        if one.name not in ADDED.get(kind, ()) and one.name != "physics":
            assert (one.default is None) == (one.name not in required and "default" not in stated), one.name


def test_an_object_is_of_one_kind():
    section = section_of(SECTIONS[RecordingSettings]["properties"]["object"])
    kinds = (MaskedObject, LabelledObject, ShapesObject, OtherScan, UnknownObject)
    assert {one.name for kind in kinds for one in fields(kind)} == set(section["properties"])


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "config").glob("*.yaml")))
def test_a_complete_configuration_is_kept(name):
    _, config = read_configs([ROOT / "config" / file for file in (*BENEATH.get(f"{name}.yaml", ()), f"{name}.yaml")])
    whole = complete(config)
    study = from_mapping(Study, whole)
    whole["analyses"] = {"pca": {}, "comparison": {}} | whole["analyses"]
    assert to_mapping(study) == whole
    assert from_mapping(Study, to_mapping(study)) == study


@dataclass(frozen=True)
class Disc:
    diameter_mm: float


@dataclass(frozen=True)
class Rods:
    number: int
    at: tuple[Disc, ...] | None = None


@dataclass(frozen=True)
class Holder:
    name: str | int
    held: Disc | Rods | None
    by_name: dict[str, Rods]


def test_types_of_fields_are_followed():
    content = {"name": "one", "held": {"number": 2, "at": [{"diameter_mm": 1}]}, "by_name": {"a": {"number": 1}}}
    holder = from_mapping(Holder, content)
    assert holder == Holder("one", Rods(2, (Disc(1),)), {"a": Rods(1)})
    assert to_mapping(holder) == content
    assert from_mapping(Holder, {"name": 3, "held": {"diameter_mm": 2.0}, "by_name": {}}).held == Disc(2.0)


def test_absent_and_null_are_kept_apart():
    """Null stays where it is the default of the schema; an absent key stays absent."""
    holder = from_mapping(Holder, {"name": "one", "held": None, "by_name": {"a": {"number": 1, "at": None}}})
    assert to_mapping(holder) == {"name": "one", "held": None, "by_name": {"a": {"number": 1}}}
