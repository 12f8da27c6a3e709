"""Write config/README.md, the reference of every configuration key, from the schema."""

import json
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
SCHEMA = ROOT / "workflow" / "lib" / "virtual_phantom" / "schemas" / "config.schema.yaml"
TARGET = ROOT / "config" / "README.md"

INTRODUCTION = """# Configuration

`config.yaml` is the default study. An overlay changes keys of it: `snakemake --cores 2 --configfile config/tiny.yaml`.

| file | what it is |
|---|---|
| `config.yaml` | the paper's protocols at a scale that two CPU cores finish |
| `tiny.yaml` | overlay: the whole workflow in a minute or two, too small to mean anything |
| `paper.yaml` | overlay: the paper's own scale, for a GPU |
| `abdomen.yaml` | overlay: a clinical CT instead of the virtual phantom |
| `large.yaml` | overlay: 1,760 acquisitions, for a cluster ([cluster.md](../docs/cluster.md)) |
| `recordings.yaml` | overlay: real scans and features held against the study ([recordings.md](../docs/recordings.md)) |
| `printed_phantom.yaml` | overlay: the printed phantom's scans ([printed-phantom.md](../docs/printed-phantom.md)) |
| `as_scanned.yaml` | overlay: the drawn phantom as a scanner scans it ([as-scanned.md](../docs/as-scanned.md)) |
| `printed_groups.yaml` | overlay on both of these: the printed phantom's scan as its groups were scanned |
| `multicentre.yaml` | overlay on `printed_phantom.yaml`: scans of it by 13 scanners |
| `every_scan.yaml` | overlay on `printed_phantom.yaml`: features of all its scans, without a study |
| `quick_proof.yaml` | overlay: 15 cases of the proof, for who changes the diagnosis ([proof.md](../docs/proof.md)) |
| `htc2022.yaml` | overlay: which physics is missing on three real discs ([htc2022.md](../docs/htc2022.md)) |

A key of `protocols`, `scans`, `noise.levels`, `recordings`, `public_scans` and its two selections, `analyses`,
`analyses.pca`, `analyses.comparison`, `diagnosis.recordings` or `diagnosis.scanners` that an overlay sets to `null`
is removed, as is a key inside a protocol
(`group: null` takes the protocol out of the groups). In the table `*` stands for a name of your own (of an effect and
its parameter under `physics`; `sirt`, `fbp` or `multicentre` under `analyses.pca`) and `[]` for each entry of a list.
This page is made from `workflow/lib/virtual_phantom/schemas/config.schema.yaml` by `docs/config_reference.py`.

| key | meaning | type | default | range | the paper |
|---|---|---|---|---|---|
"""


def rows(schema, definitions, path="", required=()):
    """One row per key, depth first."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rsplit("/", 1)[1]] | {k: v for k, v in schema.items() if k != "$ref"}
    if "properties" not in schema and not isinstance(schema.get("additionalProperties"), dict) and path:
        yield row(path, schema, required)
        items = schema.get("items", {})
        if "properties" in items:
            yield from rows(items, definitions, path + "[]")
        return
    if path and "description" in schema:
        yield row(path, schema, required)
    for key, sub in schema.get("properties", {}).items():
        yield from rows(sub, definitions, f"{path}.{key}".lstrip("."), schema.get("required", ()))
    if isinstance(schema.get("additionalProperties"), dict):
        yield from rows(schema["additionalProperties"], definitions, f"{path}.*")


def row(path, schema, required):
    """The row of one key."""
    kind = schema.get("type", "one of " + ", ".join(map(str, schema.get("enum", ()))))
    kind = " or ".join(kind) if isinstance(kind, list) else kind
    default = "required" if path.split(".")[-1] in required else ""
    if "default" in schema and schema["default"] != {}:
        default = f"`{json.dumps(schema['default']).strip(chr(34))}`"
    bounds = [
        f"{sign} {schema[name]}"
        for name, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"))
        if name in schema
    ]
    cells = (
        f"`{path}`",
        schema.get("description", ""),
        kind,
        default,
        ", ".join(bounds),
        str(schema.get("x-paper", "")),
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def page() -> str:
    """The whole page."""
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    return INTRODUCTION + "\n".join(rows(schema, schema["$defs"])) + "\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
