"""Page of the functions that `import virtual_phantom` offers, from their docstrings."""

import inspect

import virtual_phantom
from virtual_phantom.api.simulated import Scan
from virtual_phantom.diagnosis.verdict.verdict import Diagnosis
from virtual_phantom.phantom import Phantom
from virtual_phantom.physics.effect import Effect, Parameter, Reach
from virtual_phantom.physics.state import State

FUNCTIONS = ("draw_phantom", "read_phantom", "scan", "reconstruct", "extract", "diagnose")
RESULTS = (Phantom, Scan, Diagnosis)
EFFECT_CLASSES = (Effect, Parameter, Reach, State)
INTRODUCTION = """# Python API

The steps of the study and the diagnosis as functions. Arguments that you omit are as in config/paper_groups.yaml.

```python
import virtual_phantom as vp

phantom = vp.draw_phantom()
scan = vp.scan(phantom, projections=150, repeats=3)
images = vp.reconstruct(scan, "fbp")
features = vp.extract(images, phantom)
```

The notebooks use them: [a scan](../notebooks/scan.ipynb), [a study on your own CT](../notebooks/own-ct.ipynb),
[diagnosis of a real disc](../notebooks/diagnosis.ipynb). The functions return the same numbers as the workflow
(`tests/workflow/test_python.py`). Use the workflow for a whole study, because it caches results and uses all cores.

Invalid input raises `virtual_phantom.base.errors.InputError`, with a message of one line that names the argument. A bug
in Virtual Phantom raises `virtual_phantom.api.arguments.UnexpectedError`, with a message that says what to report.
"""


def entry(name: str, thing: object, signature: str = "") -> str:
    """Return a heading with the name, and the docstring."""
    return f"### {name}\n\n```text\n{signature}{inspect.getdoc(thing)}\n```\n"


def page() -> str:
    """Return the page."""
    parts = [INTRODUCTION, "## Functions\n"]
    for name in FUNCTIONS:
        function = getattr(virtual_phantom, name)
        parameters = ",\n".join(f"    {parameter}" for parameter in _parameters(function))
        parts.append(entry(name, function, f"vp.{name}(\n{parameters},\n)\n\n"))
    parts.append("## Returned objects\n")
    parts += [entry(kind.__name__, kind) for kind in RESULTS]
    parts.append("## Classes of effects\n\n[New effects](../how-to/add-an-effect.md) use these classes.\n")
    parts += [entry(kind.__name__, kind) for kind in EFFECT_CLASSES]
    return "\n".join(parts)


def _parameters(function) -> list[str]:
    """Return the parameters as they are written in a call, with their defaults."""
    named = []
    parameters = inspect.signature(function).parameters.values()
    for parameter in parameters:
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in named:
            named.append("*")
        named.append(str(parameter.replace(annotation=parameter.empty)))
    return named
