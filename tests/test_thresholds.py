"""docs/thresholds.md is what the code says, and every number that decides something says what it is of."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def load():
    spec = importlib.util.spec_from_file_location("thresholds", ROOT / "docs" / "thresholds.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["thresholds"] = module  # for its dataclass
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date():
    assert load().page() == (ROOT / "docs" / "thresholds.md").read_text(encoding="utf-8"), (
        "run python docs/thresholds.py"
    )


def test_every_number_says_what_it_is_of():
    found = load().every_threshold()
    silent = [f"{one.module}: {one.name}" for room in found.values() for one in room if not one.comment]
    assert not silent, f"say in a comment what it is of and where it comes from: {silent}"


def test_numbers_and_their_comments_are_found(tmp_path, monkeypatch):
    module = load()
    monkeypatch.setattr(module, "LIBRARY", tmp_path)
    (tmp_path / "one.py").write_text(
        '"""A module."""\n\n# Of a ball (a paper),\n# in mm.\nRADIUS_MM = 2.5\nFEW, MANY = 3, 10  # of repeats\n'
        'SILENT = -1e-3\nNAME = "no number"\nSOME = {"a": 1 / 3}  # shares\n'
    )
    found = {one.name: (one.value, one.comment) for one in module.thresholds(tmp_path / "one.py")}
    assert found == {
        "RADIUS_MM": ("2.5", "Of a ball (a paper), in mm."),
        "FEW, MANY": ("3, 10", "of repeats"),
        "SILENT": ("-1e-3", ""),
        "SOME": ('{"a": 1 / 3}', "shares"),
    }
