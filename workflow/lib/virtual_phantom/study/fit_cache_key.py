"""The fits that a diagnosis keeps: what they depend on."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

from ..config.dependencies import LIBRARY, files_behind
from ..diagnosis.selection.fit_cache import FitCache
from ..io.files import files_of, sha256

DIAGNOSIS = LIBRARY / "diagnosis"
PACKAGES = ("numpy", "scipy", "numba", "xraylib", "spekpy")  # whose numbers are in every fit
FITTING = (DIAGNOSIS / "preparation.py", DIAGNOSIS / "selection" / "trials.py")  # behind every fit


def fit_cache(folder: str | Path, model: Mapping, files: Iterable[str | Path]) -> FitCache:
    """Of one recording.

    Parameters
    ----------
    folder : str or Path
        Where they are kept.
    model : mapping
        Diagnosis.model of the recording.
    files : iterable of str or Path
        And folders of files: of the recording, and of what was scanned.
    """
    code = sorted({path for module in FITTING for path in files_behind(module)})
    declared = [_effect(name) for name in sorted(model["settings"].get("baseline", {}))]
    made_of = [model, [sha256(file) for path in files for file in files_of(path)], _hash(code), declared]
    made_of.append([platform.python_version(), *map(version, PACKAGES)])
    text = json.dumps(made_of, sort_keys=True)
    return FitCache(folder, hashlib.sha256(text.encode()).hexdigest(), _effect)


@cache
def _effect(name: str) -> str:
    return _hash(files_behind(LIBRARY / "physics" / "effects" / f"{name}.py"))


def _hash(paths: Iterable[Path]) -> str:
    """Of what files hold, whatever they are called and however old they are."""
    return hashlib.sha256("".join(map(sha256, paths)).encode()).hexdigest()
