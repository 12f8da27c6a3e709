"""What every workflow script is wrapped in: its log, its threads, and how it fails."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path

from .errors import InputError

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS",
)


@contextlib.contextmanager
def job(snakemake) -> Iterator[logging.Logger]:
    """Run a script's body: log and warnings go to the rule's log file, an InputError becomes one line and exit code 1.

    snakemake   the object that Snakemake puts into a script
    """
    log_file = Path(str(snakemake.log[0])) if snakemake.log else None
    handler = logging.StreamHandler(sys.stderr)
    if log_file:
        log_file.parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(log_file, mode="w", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%Y-%m-%d %H:%M:%S"))
    logger = logging.getLogger("virtual_phantom")
    logger.setLevel(logging.INFO)
    for target in (logger, logging.getLogger("py.warnings")):
        target.addHandler(handler)
    logging.captureWarnings(True)
    warnings.simplefilter("default")
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, str(snakemake.threads))
    try:
        yield logger
    except InputError as error:
        logger.error("%s", error)
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(1)
    except MemoryError as error:
        logger.error("%s", traceback.format_exc())
        reason = str(error) or "no more could be had"
        print(f"Error: not enough memory ({reason}); run fewer jobs at a time, or a smaller grid", file=sys.stderr)
        sys.exit(1)
    except Exception:
        logger.error("%s", traceback.format_exc())
        raise
    finally:
        for target in (logger, logging.getLogger("py.warnings")):
            target.removeHandler(handler)
        handler.close()
