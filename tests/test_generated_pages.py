"""Reference pages generated from the code (docs/generators) are complete and have no empty cells."""

import re

import pytest
import yaml
from generators import PAGES, configuration, effects, licenses, thresholds
from site_pages import ROOT

import virtual_phantom
from virtual_phantom.base.data import RESOURCES, SCHEMAS
from virtual_phantom.config.outputs import OUTPUTS
from virtual_phantom.physics.effect import PER_SCAN, Parameter, Reach, load, names


def rows(page: str) -> list[list[str]]:
    """Return the cells of all table rows."""
    lines = [line.strip("| ") for line in page.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)] for line in lines]


# Results have other columns and blanks: tests/proof/test_record.py.
@pytest.mark.parametrize("path", sorted(set(PAGES) - {"reference/validation-record.md"}))
def test_every_page_has_a_title_and_full_tables(path):
    page = PAGES[path]()
    assert page.startswith("# ") and page.endswith("\n")
    assert {len(row) for row in rows(page)} <= {3}
    # A key with an arbitrary name has the meaning of the key above it.
    assert not [row for row in rows(page) if not all(row) and not row[0].endswith("*`")]


def paths(settings, path=""):
    """Yield the paths of all values of a configuration."""
    for key, value in settings.items():
        yield from paths(value, f"{path}{key}.") if isinstance(value, dict) and value else [f"{path}{key}"]


def named(node):
    """Yield the keys that a schema describes."""
    if isinstance(node, dict):
        if isinstance(node.get("properties"), dict):
            yield from node["properties"]
        node = node.values()
    if not isinstance(node, str | int | float | None):
        for value in node:
            yield from named(value)


def test_configuration_page_has_every_key():
    page = PAGES["reference/configuration.md"]()
    keys = re.findall(r"^\| `(\S+)` ", page, re.MULTILINE)
    assert len(set(keys)) == len(keys) > 200
    known = [re.compile(re.escape(key).replace(r"\*", r"[^.]+").replace(r"\[\]", "") + r"($|\.)") for key in keys]
    default = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text(encoding="utf-8"))
    assert not [path for path in paths(default) if not any(one.match(path) for one in known)]
    schema = yaml.safe_load((SCHEMAS / "config.schema.yaml").read_text(encoding="utf-8"))
    words = {part.removesuffix("[]") for key in keys for part in key.split(".")}
    assert not set(named(schema)) - words


def test_key_has_its_type_bounds_default_and_value_in_the_paper():
    entry = {"description": "a or | b", "type": ["number", "null"], "minimum": 1, "exclusiveMaximum": 9, "default": 2}
    row = configuration.row("scan.angle", entry | {"x-paper": "5"}, True)
    assert row == "| `scan.angle` | a or \\| b | number or null; ≥ 1; < 9; required; default `2`; paper: 5 |\n"
    assert configuration.row("a", {"enum": ["x", "y"]}, False) == "| `a` |  | one of x, y |\n"


def test_effects_page_has_every_effect_with_equation_and_source():
    page = PAGES["reference/effects.md"]()
    sections = {re.match(r".*\n\n`(\w+)`", text)[1]: text for text in page.split("\n## ")[1:]}
    assert set(sections) == set(names())
    for name, text in sections.items():
        effect = load(name)
        assert f"**Equation**: {effect.equation}" in text and f"**Source**: {effect.source}" in text, name
        assert all(f"* `{parameter.name}`: {parameter.meaning}" in text for parameter in effect.parameters), name


@pytest.mark.parametrize(("unit", "shown"), [("mm/s", "-5 to 5 mm over the scan"), ("1/s", "-5 to 5 over the scan")])
def test_range_of_a_rate_is_the_change_over_the_scan(unit, shown):
    rate = Parameter("rate", unit, "rate", -20.0, 20.0, 0.0, 1.0, reach=Reach(PER_SCAN, -5.0, 5.0, 0.0, 0.5))
    assert effects.parameter_line(rate).endswith(f"(-20 to 20; off at 0); in a fit {shown}")


def test_objects_page_has_every_object():
    page = PAGES["reference/objects.md"]()
    kinds = [path.stem for path in (RESOURCES / "objects").glob("*.yaml")]
    assert len(kinds) > 5 and all(f"\n## {kind}\n" in page for kind in kinds)


def test_files_page_has_every_output():
    page = PAGES["reference/files.md"]()
    for output in OUTPUTS:
        assert re.search(rf"^\| `{re.escape(output.pattern)}[^|]*` \| [^|]+ \| `{output.rule}` \|$", page, re.MULTILINE)


def test_python_page_has_every_public_name():
    page = PAGES["reference/python.md"]()
    functions = {name: getattr(virtual_phantom, name) for name in dir(virtual_phantom)}
    public = [
        name for name, one in functions.items() if getattr(one, "__module__", "").startswith("virtual_phantom.api")
    ]
    assert len(public) > 5 and all(f"\n### {name}\n\n```text\nvp.{name}(\n" in page for name in public)


def test_thresholds_page_has_every_constant_with_a_source():
    page, found = PAGES["reference/thresholds.md"](), thresholds.every_threshold()
    every = [threshold for package in found.values() for threshold in package]
    assert len(every) > 300 and all(f"| `{threshold.name}` in " in page for threshold in every)
    silent = [f"{threshold.module}: {threshold.name}" for threshold in every if not threshold.comment]
    assert not silent, f"add a comment with meaning and source: {silent}"


def test_thresholds_are_read_with_their_comments(tmp_path, monkeypatch):
    monkeypatch.setattr(thresholds, "LIBRARY", tmp_path)
    (tmp_path / "one.py").write_text(
        '"""A module."""\n\n# Radius of a ball (a paper),\n# in mm.\nRADIUS_MM = 2.5\nFEW, MANY = 3, 10  # repeats\n'
        'SILENT = -1e-3\nNAME = "no number"\nSOME = {"a": 1 / 3}  # shares\n'
    )
    found = {
        threshold.name: (threshold.value, threshold.comment) for threshold in thresholds.thresholds(tmp_path / "one.py")
    }
    assert found == {
        "RADIUS_MM": ("2.5", "Radius of a ball (a paper), in mm."),
        "FEW, MANY": ("3, 10", "repeats"),
        "SILENT": ("-1e-3", ""),
        "SOME": ('{"a": 1 / 3}', "shares"),
    }


def test_licenses_page_has_every_pinned_package():
    pinned = licenses.pinned()
    assert len(pinned) > 100
    assert [row[:2] for row in rows(PAGES["reference/licenses.md"]())[1:]] == [list(entry) for entry in pinned.items()]


def test_every_package_is_pinned_to_the_installed_version():
    for name, version in licenses.pinned().items():
        assert licenses.distribution(name).version == version, f"{name}: run make setup"
