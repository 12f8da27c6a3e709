"""Fits of a recording, kept in files: a diagnosis that was stopped goes on from them."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable
from pathlib import Path

from ...base.errors import InputError
from ..fitting.trial import Trial
from .store import content_of, read_trial, write_trial

LOGGER = logging.getLogger("virtual_phantom")  # of the job
ALIGNMENT = "alignment"  # what the fit without any effect is called


class FitCache:
    """A folder of fits. Each says what it was made of, and counts for nothing else.

    Parameters
    ----------
    folder : str or Path
        One file for each set of effects.
    made_of : str
        Stands for all that every fit depends on: recording, settings, code.
    code : callable
        (effect) to what stands for its code.
    """

    def __init__(self, folder: str | Path, made_of: str, code: Callable[[str], str]):
        self.folder, self.made_of, self.code = Path(folder), made_of, code

    def get(self, effects: tuple[str, ...], given: Trial | None = None, against: Trial | None = None) -> Trial | None:
        """The trial that was made of this, as `trial` takes it; None if there is none."""
        path = self._path(effects)
        if not path.is_file():
            return None
        try:
            found, of = read_trial(path)
        except InputError:  # cut short or changed: made again
            return None
        return found if of == self._made_of(effects, given, against) else None

    def put(
        self, found: Trial, effects: tuple[str, ...], given: Trial | None = None, against: Trial | None = None
    ) -> None:
        """Keep a trial in the place of another one of these effects."""
        try:
            write_trial(found, self._path(effects), self._made_of(effects, given, against))
        except InputError as error:  # a full disk: the diagnosis itself may go on
            LOGGER.warning("not kept: %s", error)
        except ValueError:  # numbers that are not finite: no file holds them
            LOGGER.info("not kept: the fit of %s is not finite", " and ".join(effects) or ALIGNMENT)

    def _path(self, effects: tuple[str, ...]) -> Path:
        return self.folder / f"{'+'.join(effects) or ALIGNMENT}.json"

    def _made_of(self, effects, given, against) -> str:
        begun = [None if one is None else content_of(one) for one in (given, against)]
        said = json.dumps([self.made_of, [self.code(name) for name in effects], begun])
        return hashlib.sha256(said.encode()).hexdigest()
