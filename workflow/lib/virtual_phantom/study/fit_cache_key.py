"""Key of the cached fits of a diagnosis: a hash of everything that they depend on."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from ..base.settings import to_mapping
from ..config.dependencies import LIBRARY, code_hash, effect_file
from ..diagnosis.selection.fit_cache import FitCache
from ..diagnosis.settings import FitSettings
from ..io.files import files_of, sha256

DIAGNOSIS = LIBRARY / "diagnosis"
PACKAGES = ("numpy", "scipy", "numba", "xraylib", "spekpy")  # their versions affect every fit
# These modules and all modules that they import affect every fit.
FITTING = (DIAGNOSIS / "preparation.py", DIAGNOSIS / "selection" / "trials.py")


def fit_cache(folder: str | Path, model: FitSettings, files: Iterable[str | Path]) -> FitCache:
    """Return the cache for the fits of one recording, under the key of everything that they depend on.

    Parameters
    ----------
    folder : str or Path
        Folder of the cache.
    model : FitSettings
        Settings of the recording (Diagnosis.model).
    files : iterable of str or Path
        Files and folders of files of the recording and of the scanned object.
    """
    declared = [_effect_code_hash(name) for name in sorted(model.settings.baseline)]
    contents = [sha256(file) for path in files for file in files_of(path)]
    parts = [to_mapping(model), contents, code_hash(*FITTING), declared]
    parts.append([platform.python_version(), *map(version, PACKAGES)])
    text = json.dumps(parts, sort_keys=True)
    return FitCache(folder, hashlib.sha256(text.encode()).hexdigest(), _effect_code_hash)


def _effect_code_hash(name: str) -> str:
    return code_hash(effect_file(name))
