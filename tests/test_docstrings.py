"""What docstrings list is there: names under Parameters and Attributes are those of the code.

ruff holds the form of docstrings, and that no parameter is left out; it lets pass names that a class does not have.
"""

import ast
import inspect
import re

import pytest

from virtual_phantom.study.dependencies import LIBRARY

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


def fields(a_class: ast.ClassDef) -> list[str]:
    """Of a dataclass or a named tuple, in the class itself."""
    return [one.target.id for one in a_class.body if isinstance(one, ast.AnnAssign)]


def attributes(a_class: ast.ClassDef) -> set[str]:
    """What a class has: fields, properties, and what its methods set."""
    functions = [one for one in a_class.body if isinstance(one, FUNCTIONS)]
    stored = [one for one in ast.walk(a_class) if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store)]
    return {*fields(a_class), *(one.name for one in functions if one.decorator_list), *(one.attr for one in stored)}


def wrong(node: FUNCTIONS | ast.ClassDef) -> set[str]:
    """Names in the docstring of a function or class that it has not."""
    docstring = ast.get_docstring(node) or ""
    if isinstance(node, FUNCTIONS):
        return set(names(docstring, "Parameters")) - parameters(node)
    made_by = [one for one in node.body if isinstance(one, FUNCTIONS) and one.name == "__init__"]
    known = parameters(made_by[0]) if made_by else set(fields(node))
    return set(names(docstring, "Parameters")) - known | set(names(docstring, "Attributes")) - attributes(node)


def left_out(node: ast.ClassDef) -> set[str]:
    """Public fields that a list of attributes does not have."""
    listed = names(ast.get_docstring(node) or "", "Attributes")
    return {one for one in fields(node) if not one.startswith("_")} - set(listed) if listed else set()


def classes_and_functions():
    for path in sorted(LIBRARY.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, FUNCTIONS | ast.ClassDef):
                yield f"{path.relative_to(LIBRARY)}:{node.lineno} {node.name}", node


def test_every_name_is_in_the_code():
    assert not {where: wrong(node) for where, node in classes_and_functions() if wrong(node)}


def test_lists_of_attributes_are_complete():
    every = [(where, node) for where, node in classes_and_functions() if isinstance(node, ast.ClassDef)]
    assert not {where: left_out(node) for where, node in every if left_out(node)}


EXAMPLE = '''
def blur(image, *widths, **options):
    """Blur.

    Parameters
    ----------
    image, {name} : ndarray, shape (rows, columns)
        Grey values.
    *widths : float
        One each, mm.
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
        ("widths", "width, height", [set(), set(), set()]),
        ("picture", "width, height", [{"picture"}, set(), set()]),
        ("widths", "height", [set(), set(), {"width"}]),
        ("widths", "width, height, depth", [set(), {"depth"}, set()]),
    ],
)
def test_the_test_sees_what_is_wrong(name, attribute, expected):
    blur, spot = ast.parse(EXAMPLE.format(name=name, attribute=attribute)).body
    assert [wrong(blur), wrong(spot), left_out(spot)] == expected
