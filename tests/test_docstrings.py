"""Docstrings list no parameter and no attribute that does not exist.

Sections may omit names: an entry that only repeats the name or the type has no value. Ruff checks the rest: that public
names have a summary line, the format, and the exceptions under Raises.
"""

import ast
import inspect
import re

import pytest

from virtual_phantom.config.dependencies import LIBRARY

FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef


def names(docstring: str, section: str) -> list[str]:
    """Names in a NumPy section: `a, b : float` lists two, `*keys` and `**options` lose their stars."""
    found = re.search(rf"^{section}\n-+\n(.*?)(?=^\w[^\n]*\n-+$|\Z)", inspect.cleandoc(docstring), re.M | re.S)
    entries = re.findall(r"^\S.*", found[1], re.M) if found else []
    return [name.strip().lstrip("*") for entry in entries for name in entry.split(" : ")[0].split(",")]


def parameters(function: FUNCTIONS) -> set[str]:
    arguments = function.args
    listed = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
    return {argument.arg for argument in listed if argument}


def fields(a_class: ast.ClassDef) -> set[str]:
    """Fields of a dataclass or a named tuple, without inherited ones."""
    return {statement.target.id for statement in a_class.body if isinstance(statement, ast.AnnAssign)}


def methods(a_class: ast.ClassDef) -> list[FUNCTIONS]:
    return [statement for statement in a_class.body if isinstance(statement, FUNCTIONS)]


def attributes(a_class: ast.ClassDef) -> set[str]:
    """Fields, properties, and attributes that methods set."""
    nodes = [node for node in ast.walk(a_class) if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)]
    properties = {method.name for method in methods(a_class) if method.decorator_list}
    return fields(a_class) | properties | {node.attr for node in nodes}


def constructor_parameters(a_class: ast.ClassDef) -> set[str]:
    constructors = [method for method in methods(a_class) if method.name == "__init__"]
    return parameters(constructors[0]) if constructors else fields(a_class)


def unknown_names(node: FUNCTIONS | ast.ClassDef) -> set[str]:
    """Names in the docstring's lists that the function or class does not have."""
    docstring, is_class = ast.get_docstring(node) or "", isinstance(node, ast.ClassDef)
    known_parameters = constructor_parameters(node) if is_class else parameters(node)
    known_attributes = attributes(node) if is_class else set()
    return (
        set(names(docstring, "Parameters")) - known_parameters | set(names(docstring, "Attributes")) - known_attributes
    )


def classes_and_functions():
    for path in sorted(LIBRARY.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, FUNCTIONS | ast.ClassDef):
                yield f"{path.relative_to(LIBRARY)}:{node.lineno} {node.name}", node


def test_lists_name_existing_parameters_only():
    assert not {place: found for place, node in classes_and_functions() if (found := unknown_names(node))}


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
        ("spread", "width, height", [set(), set()]),
        ("picture", "width, height", [{"picture"}, set()]),
        ("spread", "width, height, depth", [set(), {"depth"}]),
    ],
)
def test_unknown_names_are_found(name, attribute, expected):
    example = ast.parse(EXAMPLE.format(name=name, attribute=attribute))
    assert [unknown_names(node) for node in example.body] == expected
