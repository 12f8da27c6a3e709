"""Simulate CT acquisitions of a virtual phantom and measure the stability of radiomics features.

For people at a prompt::

    import virtual_phantom as vp

    phantom = vp.draw_phantom()
    scan = vp.scan(phantom, projections=150, repeats=3)
    images = vp.reconstruct(scan, "fbp")
    features = vp.extract(images, phantom)

`vp.read_phantom` takes a CT of yours, `vp.diagnose` a recording.
"""

from importlib import import_module

__version__ = "0.1.0"

# Found when they are first used: whoever takes one module of the library does not wait for all of it.
_FUNCTIONS = {
    "draw_phantom": "simulated",
    "read_phantom": "simulated",
    "scan": "simulated",
    "reconstruct": "simulated",
    "extract": "simulated",
    "diagnose": "diagnosis",
}


def __getattr__(name: str):
    if name not in _FUNCTIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".api.{_FUNCTIONS[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_FUNCTIONS})
