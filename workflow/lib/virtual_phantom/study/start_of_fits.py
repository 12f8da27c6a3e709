"""Start of the fits of a diagnosis job: its expected time, fits of an earlier run, and progress for the display."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from ..diagnosis.request import DiagnosisRequest
from ..diagnosis.selection.fit_cache import FitCache
from ..diagnosis.selection.progress import DiagnosisProgress
from ..diagnosis.settings import FitSettings
from ..recordings.recording import Recording
from .costs.forecast import forecast_line
from .fit_cache_key import fit_cache
from .progress.job_status import status_writer

LOGGER = logging.getLogger("virtual_phantom")  # of the job


def start_of_fits(
    name: str, model: FitSettings, kept: str | Path, files: Iterable[str | Path], log: str | Path, effects: int
) -> Callable[[DiagnosisRequest, Recording], tuple[FitCache, DiagnosisProgress]]:
    """Return what `run_diagnosis` calls before it fits.

    Parameters
    ----------
    name : str
        Name of the recording in the configuration.
    model : FitSettings
        Settings of the job (study.diagnosis_jobs.Diagnosis.model).
    kept : str or Path
        Folder of the cached fits.
    files : iterable of str or Path
        Files of the recording and of the scanned object, on which the cached fits depend.
    effects : int
        Number of candidate effects; 0 if no effect is selected.
    """

    def start(request: DiagnosisRequest, recording: Recording) -> tuple[FitCache, DiagnosisProgress]:
        placed = replace(model, settings=replace(model.settings, location=dict(request.settings.location)))
        cache = fit_cache(kept, placed, files)
        if request.protocol is None:
            shape = recording.geometry.shape
            line = forecast_line(name, model, shape, effects, request.threads, request.phantom)
            if line:
                LOGGER.info("%s", line)
                print(line, flush=True)
        return cache, DiagnosisProgress(status_writer(log, name))

    return start
