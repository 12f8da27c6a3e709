"""Key of the cached fits of a diagnosis: a hash of everything that they depend on."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from ..base.settings import to_mapping
from ..config.dependencies import LIBRARY, effect_file, version_of
from ..diagnosis.selection.fit_cache import FitCache
from ..diagnosis.settings import FitSettings
from ..io.files import files_of, sha256

DIAGNOSIS = LIBRARY / "diagnosis"
PACKAGES = ("numpy", "scipy", "numba", "xraylib", "spekpy")  # their numbers affect every fit
FITTING = (DIAGNOSIS / "preparation.py", DIAGNOSIS / "selection" / "trials.py")  # their code affects every fit


def fit_cache(folder: str | Path, model: FitSettings, files: Iterable[str | Path]) -> FitCache:
    """Return the cached fits of one recording.

    Parameters
    ----------
    folder : str or Path
        Folder of the cache.
    model : FitSettings
        Settings of the recording (Diagnosis.model).
    files : iterable of str or Path
        Files and folders of files of the recording and of the scanned object.
    """
    declared = [_effect(name) for name in sorted(model.settings.baseline)]
    contents = [sha256(file) for path in files for file in files_of(path)]
    parts = [to_mapping(model), contents, version_of(*FITTING), declared]
    parts.append([platform.python_version(), *map(version, PACKAGES)])
    text = json.dumps(parts, sort_keys=True)
    return FitCache(folder, hashlib.sha256(text.encode()).hexdigest(), _effect)


def _effect(name: str) -> str:
    return version_of(effect_file(name))
