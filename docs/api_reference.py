"""Write docs/python.md, the reference of what `import virtual_phantom` offers, from the docstrings."""

import inspect
from pathlib import Path

import virtual_phantom
from virtual_phantom.api.simulated import Scan
from virtual_phantom.diagnosis.verdict.verdict import Diagnosis
from virtual_phantom.phantom import Phantom

TARGET = Path(__file__).resolve().parent / "python.md"
FUNCTIONS = ("draw_phantom", "read_phantom", "scan", "reconstruct", "extract", "diagnose")
RESULTS = (Phantom, Scan, Diagnosis)
INTRODUCTION = """# In Python

The steps of the study and the diagnosis are functions of the package. What you do not state is as in the default study.

```python
import virtual_phantom as vp

phantom = vp.draw_phantom()
scan = vp.scan(phantom, projections=150, repeats=3)
images = vp.reconstruct(scan, "fbp")
features = vp.extract(images, phantom)
```

Notebooks show them at work: [a scan](notebooks/scan.ipynb), [a study on your own CT](notebooks/own-ct.ipynb),
[a diagnosis of a real disc](notebooks/diagnosis.ipynb). A whole study, cached and on many cores, is better run by
Snakemake. The functions give the same numbers as the study does (`tests/workflow/test_python.py`). Bad input raises
`virtual_phantom.base.errors.InputError`, whose message is one line and names the argument. A fault of the
package raises `virtual_phantom.api.arguments.UnexpectedError`, whose message says what to report.
This page is made from the code by `python docs/api_reference.py`.
"""


def entry(name: str, thing: object, signature: str = "") -> str:
    """A heading with the name, and the docstring as it stands."""
    return f"### {name}\n\n```text\n{signature}{inspect.getdoc(thing)}\n```\n"


def page() -> str:
    """The page."""
    parts = [INTRODUCTION, "## Functions\n"]
    for name in FUNCTIONS:
        function = getattr(virtual_phantom, name)
        parameters = ",\n".join(f"    {one}" for one in _parameters(function))
        parts.append(entry(name, function, f"vp.{name}(\n{parameters},\n)\n\n"))
    parts.append("## What they return\n")
    parts += [entry(kind.__name__, kind) for kind in RESULTS]
    return "\n".join(parts)


def _parameters(function) -> list[str]:
    """As they are written in a call, with their defaults."""
    named = []
    parameters = inspect.signature(function).parameters.values()
    for one in parameters:
        if one.kind is one.KEYWORD_ONLY and "*" not in named:
            named.append("*")
        named.append(str(one.replace(annotation=one.empty)))
    return named


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
