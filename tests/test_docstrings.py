"""Lists in docstrings are those of the code: every name under Parameters and Attributes is there, and none is left out.

ruff holds the form of docstrings. Its own rule on parameters (D417) asks for a description where the type says all.
"""

import ast
import inspect
import re

import pytest

from virtual_phantom.config.dependencies import LIBRARY

FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef


def names(docstring: str, section: str) -> list[str]:
    """What a NumPy section lists: `a, b : float` are two names, `*keys` and `**options` go without their stars."""
    found = re.search(rf"^{section}\n-+\n(.*?)(?=^\w[^\n]*\n-+$|\Z)", inspect.cleandoc(docstring), re.M | re.S)
    entries = re.findall(r"^\S.*", found[1], re.M) if found else []
    return [name.strip().lstrip("*") for entry in entries for name in entry.split(" : ")[0].split(",")]


def parameters(function: FUNCTIONS) -> set[str]:
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    return {one.arg for one in every if one} - {"self", "cls"}


def fields(a_class: ast.ClassDef) -> set[str]:
    """Public ones of a dataclass or a named tuple, in the class itself."""
    targets = [one.target.id for one in a_class.body if isinstance(one, ast.AnnAssign)]
    return {name for name in targets if not name.startswith("_")}


def attributes(a_class: ast.ClassDef) -> set[str]:
    """What a class has: fields, properties, and what its methods set."""
    functions = [one for one in a_class.body if isinstance(one, FUNCTIONS)]
    stored = [one for one in ast.walk(a_class) if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store)]
    return {*fields(a_class), *(one.name for one in functions if one.decorator_list), *(one.attr for one in stored)}


def made_with(a_class: ast.ClassDef) -> set[str]:
    made_by = [one for one in a_class.body if isinstance(one, FUNCTIONS) and one.name == "__init__"]
    return parameters(made_by[0]) if made_by else fields(a_class)


def mistakes(node: FUNCTIONS | ast.ClassDef) -> str:
    """In the lists of a function or class: names that it has not, and those that a list leaves out."""
    docstring = ast.get_docstring(node) or ""
    given, had = set(names(docstring, "Parameters")), set(names(docstring, "Attributes"))
    takes = parameters(node) if isinstance(node, FUNCTIONS) else made_with(node)
    has, listed = (attributes(node), fields(node)) if isinstance(node, ast.ClassDef) else (set(), set())
    extra = given - takes | had - has
    missing = (takes - given if given else set()) | (listed - had if had else set())
    return "; ".join(
        f"{what} {', '.join(sorted(some))}" for what, some in (("has no", extra), ("leaves out", missing)) if some
    )


def classes_and_functions():
    for path in sorted(LIBRARY.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, FUNCTIONS | ast.ClassDef):
                yield f"{path.relative_to(LIBRARY)}:{node.lineno} {node.name}", node


def test_lists_are_those_of_the_code():
    assert not {where: mistakes(node) for where, node in classes_and_functions() if mistakes(node)}


EXAMPLE = '''
def blur(image, spread, *widths, **options):
    """Blur.

    Parameters
    ----------
    image, {name} : ndarray, shape (rows, columns)
        Grey values.
    *widths : float
    **options
        Of the filter.

    Returns
    -------
    ndarray
    """

class Spot:
    """A spot.

    Attributes
    ----------
    {attribute} : float
        mm.
    """

    width: float
    height: float
'''


@pytest.mark.parametrize(
    "name, attribute, expected",
    [
        ("spread", "width, height", ["", ""]),
        ("picture", "width, height", ["has no picture; leaves out spread", ""]),
        ("spread", "height", ["", "leaves out width"]),
        ("spread", "width, height, depth", ["", "has no depth"]),
    ],
)
def test_the_test_sees_what_is_wrong(name, attribute, expected):
    example = ast.parse(EXAMPLE.format(name=name, attribute=attribute))
    assert [mistakes(node) for node in example.body] == expected
