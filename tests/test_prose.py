"""The project's prose follows its style, and the check detects violations."""

import json

import pytest
from prose import ROOT, UNCONVERTED, check, converted, findings, markdown, notebook, python, yaml_file
from prose import rules as rule_file

MODULE = '''"""Of a scan.

Parameters
----------
angle : float
    {long}
"""
# The detector was made{break_}anew.
NOTE = "What this string says is left out of the report"
NAME = "left out"
'''


def rules(texts):
    return [finding.rule for text in texts for finding in check(text)]


@pytest.mark.parametrize("path", converted(), ids=lambda path: str(path.relative_to(ROOT)))
def test_prose(path):
    assert not [f"{path.name}:{finding.line}: {finding.rule}: {finding.text}" for finding in findings(path)]


def test_unconverted_paths_exist():
    assert [name for name in UNCONVERTED if not any(ROOT.glob(name))] == []


@pytest.mark.parametrize(
    ("page", "expected"),
    [
        ("# A title\n\nA short sentence. Another one.", []),
        ("* " + "word " * 16 + "\n  " + "word " * 16 + "\n", ["long"]),
        ("* " + "word " * 16 + "\n* " + "word " * 16 + "\n", []),
        ("| name | meaning |\n|---|---|\n| a | tissues told apart |\n", ["word"]),
        ("One sentence. Of the others nothing is known.", ["start"]),
        ("The image is *noisy*, apart from its edges; `told apart` is code.", []),
        ("It was held\nagainst a closed form.", ["word"]),
        ("```\nanew\n```\n<!-- anew -->\n[again](anew.md)", []),
        ("The colour of the centre; `grey_levels` and the multicentre file.", ["spelling", "spelling"]),
        ("As shown by Flouris et al. Of course this is one sentence.", []),
    ],
)
def test_pages(page, expected):
    assert rules(markdown(page)) == expected


def test_other_files():
    page = 'a: {description: "Left out here.", b: [{note: Held against it.}]}  # told apart\n'
    assert [(one.line, one.rule) for text in yaml_file(page) for one in check(text)] == [(1, "word")] * 3
    assert rules(rule_file('rule a:\n    """Of a scan."""\n    input: # made anew\n')) == ["word", "docstring"]
    cells = [{"cell_type": "markdown", "source": ["It is\n", "ours."]}, {"cell_type": "code", "source": ["# ours"]}]
    assert rules(notebook(json.dumps({"cells": cells}))) == ["word"]


def test_modules():
    found = rules(python(MODULE.format(long="word " * 31, break_="\n# ")))
    assert sorted(found) == ["docstring", "long", "word", "word"]
    assert rules(python('"""Return the scan."""\nraise ValueError(f"{name} is short enough and fine")\n')) == []
