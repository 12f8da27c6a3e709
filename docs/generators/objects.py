"""Page of the included objects of known geometry, from their files in the library."""

import yaml

from virtual_phantom.base.data import RESOURCES

INTRODUCTION = """# Included objects

Test objects of known geometry for a [diagnosis or a study](../how-to/objects.md). *Assumptions* are properties that
manufacturers do not publish; read them before you trust a verdict. Parameters without a default are required."""


def section(kind: str, content: dict) -> str:
    """Return what an object is, its parameters, assumptions and sources."""
    lines = [f"## {kind}", "", content["description"], ""]
    for name, parameter in content["parameters"].items():
        default = f" (default {parameter['default']})" if "default" in parameter else ""
        lines.append(f"* `{name}`: {parameter['description'].rstrip('.')}{default}")
    for title, key in (("Assumptions", "not_known"), ("Sources", "sources")):
        if content[key]:
            lines += ["", f"{title}:", "", *(f"* {text}" for text in content[key])]
    return "\n".join(lines)


def page() -> str:
    """Return the page, with a section for every object."""
    paths = sorted((RESOURCES / "objects").glob("*.yaml"))
    sections = [section(path.stem, yaml.safe_load(path.read_text(encoding="utf-8"))) for path in paths]
    return "\n\n".join([INTRODUCTION, *sections]) + "\n"
