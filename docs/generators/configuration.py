"""Page of the configuration keys, from the schema."""

import json

from virtual_phantom.base.data import SCHEMAS
from virtual_phantom.io.schema import read_schema

INTRODUCTION = """# Configuration keys

[Configuration files](../../config/README.md) explains how files combine. In a key, `*` is a name that you choose: of a
protocol, a noise level, a recording, or of an effect and its parameter under `physics`. Under `analyses.pca` it is
`sirt`, `fbp` or `multicentre`. `[]` is an entry of a list. *Paper* is the value in [Flouris et al., Sci. Rep. 12, 4732
(2022)](https://doi.org/10.1038/s41598-022-08301-1).
"""
GENERAL = "General keys"
HEADER = "| key | meaning | values |\n|---|---|---|\n"
BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def page() -> str:
    """Return the page: a section for every top-level key that is an object, and a row for every key."""
    schema = read_schema(SCHEMAS / "config.schema.yaml")
    sections: dict[str, list[str]] = {}
    for path, entry, required in keys(schema, schema["$defs"]):
        section = path.split(".")[0].removesuffix("[]") if "." in path or entry.get("type") == "object" else GENERAL
        sections.setdefault(section, []).append(row(path, entry, required))
    parts = [f"\n## {name}\n\n{HEADER}{''.join(rows)}" for name, rows in sections.items()]
    return INTRODUCTION + "".join(parts)


def keys(schema, definitions, path="", required=()):
    """Yield path, schema and whether it is required of every key, depth first."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rsplit("/", 1)[1]] | {k: v for k, v in schema.items() if k != "$ref"}
    if "properties" not in schema and not isinstance(schema.get("additionalProperties"), dict) and path:
        yield path, schema, path.split(".")[-1] in required
        items = schema.get("items", {})
        if "properties" in items:
            yield from keys(items, definitions, path + "[]")
        return
    if path and "description" in schema:
        yield path, schema, path.split(".")[-1] in required
    for key, sub in schema.get("properties", {}).items():
        yield from keys(sub, definitions, f"{path}.{key}".lstrip("."), schema.get("required", ()))
    if isinstance(schema.get("additionalProperties"), dict):
        yield from keys(schema["additionalProperties"], definitions, f"{path}.*")


def row(path, schema, required):
    """Return the table row of a key."""
    kind = schema.get("type", "one of " + ", ".join(map(str, schema.get("enum", ()))))
    values = [" or ".join(kind) if isinstance(kind, list) else kind]
    values += [f"{sign} {schema[name]}" for name, sign in BOUNDS.items() if name in schema]
    if required:
        values.append("required")
    if "default" in schema and schema["default"] != {}:
        values.append(f"default `{json.dumps(schema['default']).strip(chr(34))}`")
    if "x-paper" in schema:
        values.append(f"paper: {schema['x-paper']}")
    cells = (f"`{path}`", schema.get("description", ""), "; ".join(values))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"
