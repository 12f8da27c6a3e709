"""Validation of documents against JSON schemas: default values, and one line per mistake."""

from __future__ import annotations

import copy
import datetime
import difflib
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from numbers import Real
from pathlib import Path

from jsonschema import Draft202012Validator, validators
from jsonschema.exceptions import best_match

from ..base.data import SCHEMAS, shipped_yaml
from ..base.errors import InputError, did_you_mean

SCHEMA = SCHEMAS / "config.schema.yaml"
DEEPEST, MOST_ITEMS = 40, 100_000  # largest numbers of levels and of items of a document
# Unlike in JSON, 150.0 is no integer, because range() refuses it, and tuples are arrays, because callers pass them.
_Validator = validators.extend(
    Draft202012Validator,
    type_checker=Draft202012Validator.TYPE_CHECKER.redefine_many(
        {
            "integer": lambda _, value: isinstance(value, int) and not isinstance(value, bool),
            "number": lambda _, value: _finite(value),
            "array": lambda _, value: isinstance(value, list | tuple),
        }
    ),
)


def _finite(value: object) -> bool:
    """Return whether a value is a finite number; JSON has no NaN, and Python's truth values are integers."""
    return isinstance(value, Real) and not isinstance(value, bool) and (isinstance(value, int) or math.isfinite(value))


BOUNDS = {"minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most", "exclusiveMaximum": "less than"}


def validate(document: dict, schema: dict, source: str) -> None:
    """Check a document against a schema (draft 2020-12), and that all keys are text, unlike YAML's 1 or yes.

    Raises
    ------
    InputError
        One line that begins with `source` and names the key, for what the schema refuses.
    """
    check_nesting(document, source)
    for path, key in _keys_not_text(document, ()):
        raise InputError(_not_text(path, key, source))
    error = best_match(_Validator(schema).iter_errors(document), key=_depth_first)
    if error is not None:
        raise InputError(_one_line(error, source))


@dataclass(frozen=True)
class Mistake:
    """A mistake in a document: its location, and a line on what is wrong and what to do."""

    path: tuple
    line: str


def mistakes(
    document: dict, schema: dict, source: str, entries: Collection[tuple[str, ...]] = ()
) -> tuple[list[Mistake], dict]:
    """Return all mistakes of a document, and the document without them.

    Parameters
    ----------
    document : dict
        A document that passes `check_nesting`; not changed.
    schema : dict
        JSON schema, draft 2020-12.
    source : str
        Beginning of the lines: the file or the section.
    entries : collection of tuple of str, optional
        Sections whose entries, like list items, are removed as a whole, because a part would have another meaning.

    Returns
    -------
    found : list of Mistake
        One per key: first the message of `validate`, then in the order of the document.
    rest : dict
        The document without every section, list item or value that has a mistake. Required sections at the top may be
        missing.
    """
    found: dict[tuple, Mistake] = {}
    rest = copy.deepcopy(document)
    for path, key in list(_keys_not_text(document, ())):
        found[(*path, key)] = Mistake((*path, key), _not_text(path, key, source))
        _without(rest, {(*path, key)})
    first = best_match(_Validator(schema).iter_errors(rest), key=_depth_first)
    errors = [] if first is None else [first, *_Validator(schema).iter_errors(rest)]
    for error in errors:
        for mistake in _each(error, source):
            found.setdefault(mistake.path, mistake)
    for _ in range(DEEPEST):  # a removed value may be required one level higher
        places = {place for error in _Validator(schema).iter_errors(rest) for place in _places(error, rest, entries)}
        if not places:
            break
        _without(rest, places)
    return list(found.values()), rest


def _each(error, source) -> Iterator[Mistake]:
    """Return the mistakes of one error; a missing key is not reported if it was only misspelled."""
    path = tuple(error.absolute_path)
    if error.validator == "required":
        missing = [key for key in error.validator_value if key not in error.instance]
        meant_for = {close for key in _extra(error) for close in difflib.get_close_matches(str(key), missing, 1)}
        (key,) = [key for key in missing if error.message.startswith(repr(key))]
        if key not in meant_for:
            yield Mistake((*path, key), _one_line(error, source))
    else:
        for place in _wrong(error):
            yield Mistake(place, _one_line(error, source, place))


def _wrong(error) -> list[tuple]:
    """Return the locations that an error is about: unknown or invalid keys, or one value."""
    path = tuple(error.absolute_path)
    if error.validator == "additionalProperties":
        return [(*path, key) for key in _extra(error)]
    return [(*path, error.instance)] if "propertyNames" in error.absolute_schema_path else [path]


def _extra(error) -> list:
    """Return the keys of the invalid section that its schema does not name."""
    return sorted(set(error.instance) - set(error.schema.get("properties", ())), key=str)


def _places(error, document, entries) -> Iterator[tuple]:
    """Return the locations to remove from a document for an error; none if it is at the top."""
    for place in filter(None, _wrong(error)):
        value = document
        for depth, key in enumerate(place):
            if place[:depth] in entries or (isinstance(value, list | tuple) and isinstance(value[key], dict)):
                place = place[: depth + 1]
                break
            value = value.get(key) if isinstance(value, dict) else value[key]
        yield place


def _without(document, places: set[tuple]) -> None:
    """Remove values from a document, in place; the last items of a list first, so that indices stay valid."""
    for place in sorted(places, key=lambda place: [(isinstance(key, int), key) for key in map(_ordered, place)])[::-1]:
        value = document
        try:
            for key in place[:-1]:
                value = value[key]
            del value[place[-1]]
        except (KeyError, IndexError, TypeError):  # removed with its parent
            continue


def _ordered(key):
    return key if isinstance(key, int) and not isinstance(key, bool) else str(key)


def check_nesting(document, source: str) -> None:
    """Refuse a document that is too deep or too large.

    With YAML's aliases, a few lines can expand to billions of items or to a document that contains itself.

    Raises
    ------
    InputError
        For more than DEEPEST levels or MOST_ITEMS items.
    """
    waiting, seen = [(document, 0)], 0
    while waiting:
        value, depth = waiting.pop()
        seen += 1
        if depth > DEEPEST or seen > MOST_ITEMS:
            raise InputError(f"{source}: is nested too deeply or unfolds to too many items; leave out aliases")
        if isinstance(value, dict):
            waiting += [(item, depth + 1) for item in value.values()]
        elif isinstance(value, list | tuple):
            waiting += [(item, depth + 1) for item in value]


@cache
def schema_of(*section: str) -> dict:
    """Return the schema, for `validate`, of a section of the configuration given by its keys."""
    whole = part = read_schema(SCHEMA)
    for key in section:
        part = part["properties"][key]
    return {**part, "$defs": whole["$defs"]}


def defaults_of(*section: str) -> dict:
    """Return the schema defaults of a section of the configuration given by its keys."""
    document: dict = {}
    fill_defaults(document, schema_of(*section))
    return document


def fill_defaults(document: dict, schema: dict) -> None:
    """Add to a valid document, in place, every missing key that has a default in the schema."""
    for _ in _with_defaults(Draft202012Validator)(schema).iter_errors(document):
        pass


@cache
def read_schema(path: Path) -> dict:
    """Read a schema file in YAML."""
    return shipped_yaml(path)


def _keys_not_text(value, path) -> Iterator[tuple[tuple, object]]:
    """Yield (location, key) of keys that YAML reads as other types, outer keys first."""
    if isinstance(value, dict):
        yield from ((path, key) for key in value if not isinstance(key, str))
    elif not isinstance(value, list | tuple):
        return
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _keys_not_text(item, (*path, key))


def _not_text(path, key, source) -> str:
    words = {True: " (as yes, on and true are)", False: " (as no, off and false are)"}
    kind = words[key] if isinstance(key, bool) else ""
    return (
        f"{source}: the key {key} in {_where(path, source)} is not text to YAML{kind}; correct it, or put it in quotes "
        "if it is a name"
    )


def _where(path, source):
    return ".".join(map(str, path)) or Path(source).name


def _depth_first(error):
    return -len(error.absolute_path), error.validator not in ("additionalProperties", "required")


def _one_line(error, source, place=None):
    """Return the message of an error, for one of its locations if it has several."""
    where = _where(error.absolute_path, source)
    if error.validator == "additionalProperties":
        key, known = (place or _wrong(error)[0])[-1], list(error.schema.get("properties", ()))
        return f"{source}: unknown key '{key}' in {where}; {did_you_mean(key, known, 'known keys')}"
    if error.validator == "enum":
        choices = ", ".join(str(value) for value in error.validator_value)
        return f"{source}: {where} is '{error.instance}'; use one of {choices}"
    if error.validator == "pattern" and "title" in error.schema:
        return f"{source}: {where}: {error.instance!r} must be of {error.schema['title']}"
    if error.validator == "type" and (number := _number_meant(error.instance, error.validator_value)):
        kind = "text" if isinstance(error.instance, str) else "not a whole number"
        return f"{source}: {where}: {error.instance!r} is {kind} to YAML; write {number}"
    if error.validator == "type" and isinstance(error.instance, float) and not math.isfinite(error.instance):
        return f"{source}: {where} is {error.instance}; give a finite number"
    if error.validator == "type" and (quoted := _quotes_missing(error.instance, error.validator_value)):
        return f"{source}: {where}: {quoted}"
    what = error.schema.get("description", "") if isinstance(error.schema, dict) else ""
    message = " ".join(error.message.split())
    if error.validator == "minItems":
        message = f"has {len(error.instance)} entries; give at least {error.validator_value}"
    elif error.validator in BOUNDS:
        message += f"; give {BOUNDS[error.validator]} {error.validator_value:g}"
    place = source if where == source else f"{source}: {where}"
    return f"{place}: {message[:300]}" + (f" ({what})" if what else "")


def _number_meant(value, kinds) -> str | None:
    """Return how YAML 1.1, which needs a point and a signed exponent, writes a number read as text, or None."""
    kinds = [kinds] if isinstance(kinds, str) else kinds
    try:
        number = float(value) if isinstance(value, str | float) else math.nan
    except ValueError:
        return None
    if "number" in kinds and math.isfinite(number):
        mantissa, exponential, exponent = value.strip().lower().partition("e")
        if not exponential:
            return mantissa
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}"
    return str(int(number)) if "integer" in kinds and number.is_integer() else None


def _quotes_missing(value, kinds) -> str | None:
    """Return advice for a word, number or date of YAML where text is expected."""
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if "string" not in kinds:
        return None
    if value is None:
        return "is null or empty to YAML; give text, in quotes if it is a word such as null"
    if isinstance(value, bool):
        words = "yes, on and true" if value else "no, off and false"
        return f"is {str(value).lower()} to YAML, as {words} are without quotes; write the text in quotes"
    if isinstance(value, int | float):
        return f'is the number {value} to YAML; write it in quotes if it is a name: "{value}"'
    if isinstance(value, datetime.date):  # also a datetime
        return f'is a date to YAML; write it in quotes: "{value}"'
    return None


def _with_defaults(validator_class):
    def set_defaults(validator, properties, instance, schema):
        if isinstance(instance, dict):
            for key, sub in properties.items():
                if "default" in sub:
                    instance.setdefault(key, copy.deepcopy(sub["default"]))
        yield from validator_class.VALIDATORS["properties"](validator, properties, instance, schema)

    return validators.extend(validator_class, {"properties": set_defaults})
