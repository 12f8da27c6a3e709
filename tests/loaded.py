"""Modules of the library that a script loads, found in a separate process after all indirect imports.

python tests/loaded.py '[[FILE, ...], [MODULE, ...]]'      prints their names
"""

import ast
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import warm

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = ROOT / "workflow" / "lib"


def load(path, package):
    """Run the imports of a file, in functions too."""
    for node in ast.walk(ast.parse(Path(path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            statement = ast.Module([node], [])
            try:
                exec(compile(statement, str(path), "exec"), {"__name__": "probe", "__package__": package})
            except ImportError as error:
                if (error.name or "").split(".")[0] == "virtual_phantom":
                    raise


def load_all(files, named):
    """Load the imports of files and modules, then those of every loaded module of the library, until no more follow.

    Modules imported by name (effects, callbacks) are `named`. Returns the names of the library's modules.
    """
    for name in named:
        importlib.import_module(name)
    for path in files:
        load(path, None)
    done = set()
    while waiting := {one for one in sys.modules if one.split(".")[0] == "virtual_phantom"} - done:
        for name in waiting:
            load(sys.modules[name].__file__, sys.modules[name].__spec__.parent)
        done |= waiting
    return sorted(done)


def loaded(*files: Path, named=(), library: Path = LIBRARY) -> set[str]:
    """Names of the library's modules that are loaded, below virtual_phantom, by the imports of these files.

    named     additional modules that are imported by name
    library   the folder that holds virtual_phantom
    Third-party packages that are not installed are skipped.
    """
    argument = json.dumps([[str(file) for file in files], list(named)])
    environment = os.environ | {"PYTHONPATH": str(library)}
    run = subprocess.run([warm.python(), __file__, argument], capture_output=True, text=True, env=environment)
    assert run.returncode == 0, run.stderr[-4000:]
    return {name.partition(".")[2] for name in json.loads(run.stdout)} - {""}


if __name__ == "__main__":
    print(json.dumps(load_all(*json.loads(sys.argv[1]))))
