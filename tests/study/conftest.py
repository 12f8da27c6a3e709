import pickle

import pytest

from virtual_phantom.phantom import synthetic
from virtual_phantom.study.checks import preflight_scan

KEPT = {}


@pytest.fixture(autouse=True)
def kept_coverage(monkeypatch):
    """Compute the outline of a phantom and the coverage by a scan once: most configurations have those of a base."""

    def kept(function):
        def call(*arguments):
            key = function.__name__, pickle.dumps(arguments)
            if key not in KEPT:
                KEPT[key] = function(*arguments)
            return KEPT[key]

        return call

    for module, name in ((synthetic, "find_outline"), (preflight_scan, "worst_share")):
        monkeypatch.setattr(module, name, kept(getattr(module, name)))
