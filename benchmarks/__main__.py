"""List the benchmarks, or run one: `python -m benchmarks [list]`, `python -m benchmarks run NAME [options]`.

A scenario is a module of this folder. The first line of its docstring says what it measures and how long it takes. It
defines `run(options)`, which may return an exit status, and `add_arguments(parser)` if it has options. A module with
`ONE_THREAD = True` runs with one thread: the limit is set before the module and NumPy are imported.
"""

import argparse
import ast
import importlib
import os
import sys
from pathlib import Path

from virtual_phantom.base.errors import InputError

from . import THREAD_VARIABLES

FOLDER = Path(__file__).parent


def scenarios():
    """{name: path} of all scenarios."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.py")) if not path.name.startswith("_")}


def syntax_tree(path):
    """Syntax tree of a scenario, which is read without importing NumPy."""
    return ast.parse(path.read_text(encoding="utf-8"))


def limit_threads(path):
    """Limit this process to one thread if a scenario requests it; NumPy must not be imported yet."""
    assigned = (node for node in syntax_tree(path).body if isinstance(node, ast.Assign))
    if any(ast.unparse(node) == "ONE_THREAD = True" for node in assigned):
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def build_parser(name, module):
    """Parser of a scenario's options."""
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks run {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if hasattr(module, "add_arguments"):
        module.add_arguments(parser)
    return parser


def main(arguments=None):
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    known = scenarios()
    if arguments in ([], ["list"]):
        width = max(map(len, known))
        for name, path in known.items():
            print(f"{name:{width}}  {ast.get_docstring(syntax_tree(path)).splitlines()[0]}")
        return 0
    if len(arguments) < 2 or arguments[0] != "run" or arguments[1].replace("-", "_") not in known:
        sys.exit("usage: python -m benchmarks [list | run NAME [options]]; `list` prints the names")
    name = arguments[1].replace("-", "_")
    limit_threads(known[name])
    module = importlib.import_module(f"benchmarks.{name}")
    try:
        return module.run(build_parser(name, module).parse_args(arguments[2:]))
    except InputError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    sys.exit(main())
