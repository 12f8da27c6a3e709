"""Context in which workflow scripts run: log file, threads, and one line for each error."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import sys
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path

from ..base.console import INTERRUPTED, show_any_character, unexpected
from ..base.errors import InputError, lines_of, printed
from .progress.job_status import remove_status

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS",
)
log = logging.getLogger("virtual_phantom")  # the package's logger, which scripts use
LINE, TIME = "%(asctime)s %(levelname)s %(message)s", "%Y-%m-%d %H:%M:%S"
ERROR_LINE = re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ERROR (.*)$", re.MULTILINE)


@contextlib.contextmanager
def job(snakemake) -> Iterator[None]:
    """Run a script: log and warnings go to the rule's log file, an InputError becomes its lines and exit code 1.

    Parameters
    ----------
    snakemake : Snakemake
        The object that Snakemake adds to the globals of a script.
    """
    show_any_character()
    log_file = Path(str(snakemake.log[0])) if snakemake.log else None
    handler = logging.StreamHandler(sys.stderr)
    if log_file:
        log_file.parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(log_file, mode="w", encoding="utf-8")
    handler.setFormatter(logging.Formatter(LINE, TIME))
    log.setLevel(logging.INFO)
    for target in (log, logging.getLogger("py.warnings")):
        target.addHandler(handler)
    logging.captureWarnings(True)
    warnings.simplefilter("default")
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, str(snakemake.threads))
    try:
        yield
    except InputError as error:
        for line in lines_of(error)[:-1]:
            log.error("%s", line)
        _fail(lines_of(error)[-1], printed(error))
    except MemoryError as error:
        log.error("%s", traceback.format_exc())
        reason = str(error) or "no more is available"
        _fail(f"not enough memory ({reason}); run fewer jobs at a time, or a smaller grid")
    except Exception as error:
        log.error("%s", traceback.format_exc())
        _fail(unexpected(error, "the log"))
    except KeyboardInterrupt:  # Ctrl-C reaches scripts too; Snakemake itself reports that it stops
        sys.exit(INTERRUPTED)
    finally:
        for target in (log, logging.getLogger("py.warnings")):
            target.removeHandler(handler)
        handler.close()
        if log_file:
            remove_status(log_file)


def _fail(message: str, shown: str | None = None) -> None:
    """Log one line, print it or the text that is `shown` instead, and exit."""
    log.error("%s", message)
    print(shown or f"Error: {message}", file=sys.stderr)
    sys.exit(1)


def last_reason(log_file: str | Path, since: float) -> str | None:
    """Return why a job failed: the last error in its log, where `job` writes one line for each failure.

    Parameters
    ----------
    since : float
        Start of the job, seconds since the epoch.

    Returns
    -------
    str or None
        None if the log has no error or was not written since then.
    """
    path = Path(log_file)
    try:
        found = ERROR_LINE.findall(path.read_text(encoding="utf-8")) if path.stat().st_mtime >= since else []
    except (OSError, UnicodeDecodeError):
        return None
    return found[-1] if found else None
