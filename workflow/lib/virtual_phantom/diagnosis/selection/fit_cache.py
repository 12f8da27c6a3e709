"""Cache of fits in files: a diagnosis that was stopped continues from them."""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...base.errors import InputError, refusing
from ...io.files import read_text, write_text
from ..fitting.fit import Fit
from ..fitting.linearization import Linearization, LinearizationPoint
from ..fitting.trial import Trial
from ..noise.gain_pattern import Pattern

LOGGER = logging.getLogger("virtual_phantom")
PER_CONSTANT = "per_constant"  # of Pattern
ALIGNMENT = "alignment"  # name of the fit without any effect


class FitCache:
    """Folder of fits, each valid for the inputs that its key stands for.

    Parameters
    ----------
    folder : str or Path
        One file for each set of effects.
    made_of : str
        Key of everything that all fits depend on: recording, settings, code.
    code : callable
        Returns the key of the code of an effect.
    """

    def __init__(self, folder: str | Path, made_of: str, code: Callable[[str], str]):
        self.folder, self.made_of, self.code = Path(folder), made_of, code

    def get(self, effects: tuple[str, ...], *rest) -> Trial | None:
        """Return the stored trial for these arguments of `trial`; None if there is none."""
        path = self._path(effects)
        if not path.is_file():
            return None
        try:
            found, of = read_trial(path)
        except InputError:  # cut short or changed
            return None
        return found if of == self._made_of(effects, *rest) else None

    def put(self, found: Trial, effects: tuple[str, ...], *rest) -> None:
        """Store a trial for these arguments of `trial`; it replaces an earlier one of the same effects.

        Fits with a pattern of dark signals are not stored, because this pattern is as large as the data.
        """
        if found.fit.of_dark_signals:
            return
        try:
            write_trial(found, self._path(effects), self._made_of(effects, *rest))
        except InputError as error:  # a full disk does not stop the diagnosis
            LOGGER.warning("not kept: %s", error)
        except ValueError:  # JSON has no infinite numbers
            LOGGER.info("not kept: the fit of %s is not finite", " and ".join(effects) or ALIGNMENT)

    def _path(self, effects: tuple[str, ...]) -> Path:
        return self.folder / f"{'+'.join(effects) or ALIGNMENT}.json"

    def _made_of(self, effects, given=None, against=None, needed=math.inf) -> str:
        begun = [None if trial is None else content_of(trial) for trial in (given, against)]
        text = json.dumps([self.made_of, [self.code(name) for name in effects], begun, needed])
        return hashlib.sha256(text.encode()).hexdigest()


def content_of(trial: Trial) -> dict:
    """Return a trial as JSON content."""
    fit = asdict(trial.fit)
    if fit["pattern"] is not None:
        kept = (item for item in fit["pattern"].items() if item[0] != PER_CONSTANT)
        fit["pattern"] = {name: np.asarray(values).tolist() for name, values in kept}
    return {"fit": fit, "score": trial.score, "p": trial.p}


def write_trial(trial: Trial, path: str | Path, made_of: str) -> None:
    """Write a trial and the key of its inputs."""
    content = content_of(trial) | {"made_of": made_of}
    write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", path)


def read_trial(path: str | Path) -> tuple[Trial, str]:
    """Read what `write_trial` wrote.

    Raises
    ------
    InputError
        If it is missing or invalid.
    """
    kinds = (OSError, ValueError, KeyError, TypeError)
    with refusing(f"{path}: is no fit of a diagnosis", *kinds, advice="make it again"):
        content = json.loads(read_text(path))
        fit = content["fit"]
        fit["effects"], fit["parts"] = tuple(fit["effects"]), tuple(fit["parts"])
        fit["linearization"] = Linearization(
            *(LinearizationPoint(**fit["linearization"][about]) for about in ("errors", "rays"))
        )
        if fit["pattern"] is not None:
            arrays = {name: np.array(values) for name, values in fit["pattern"].items() if isinstance(values, list)}
            fit["pattern"] = Pattern(**fit["pattern"] | arrays)
        return Trial(Fit(**fit), content["score"], content["p"]), content["made_of"]
