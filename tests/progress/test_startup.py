"""Output before the first job and in a dry run, with records as Snakemake logs them."""

import io
import logging
import sys
from types import SimpleNamespace

import pytest
from snakemake.logging import DefaultFormatter
from snakemake.settings.enums import Quietness
from snakemake_interface_logger_plugins.common import LogEvent

from virtual_phantom.study.progress import startup
from virtual_phantom.study.progress.console import Console, install_console
from virtual_phantom.study.progress.startup import DryRunHandler, StartupHandler, install_startup_handler

SETTINGS = {"verbose": False, "debug_dag": False, "dryrun": False, "printshellcmds": False, "quiet": {Quietness.HOST}}


def quiet(monkeypatch, **more):
    """Logger as Snakemake's after install_startup_handler, with its stream."""
    logger, stream = logging.Logger("a run"), io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    handler = logging.StreamHandler()
    handler.setFormatter(DefaultFormatter(quiet=set()))
    logger.addHandler(handler)
    install_startup_handler(logger, SimpleNamespace(**SETTINGS | more))
    return logger, stream


def begun(logger):
    """Records that Snakemake logs before the first job."""
    logger.info("Config file config.yaml is extended by additional config specified via the command line.")
    logger.info("Building DAG of jobs...")
    logger.info("Provided cores: 2", extra={"event": LogEvent.RESOURCES_INFO})
    logger.info("Job stats:\njob count", extra={"event": LogEvent.RUN_INFO})


@pytest.mark.parametrize(
    "more, kind",
    [
        ({}, StartupHandler),
        ({"quiet": {Quietness.HOST, Quietness.RULES}}, StartupHandler),
        ({"dryrun": True}, DryRunHandler),
        ({"verbose": True}, logging.StreamHandler),
        ({"debug_dag": True}, logging.StreamHandler),
        ({"quiet": {Quietness.PROGRESS}}, logging.StreamHandler),
        ({"quiet": {Quietness.ALL}}, logging.StreamHandler),
        ({"dryrun": True, "printshellcmds": True}, logging.StreamHandler),
        ({"dryrun": True, "quiet": {Quietness.RULES}}, logging.StreamHandler),
    ],
)
def test_other_verbosity_gives_snakemakes_output(more, kind, monkeypatch):
    logger, stream = quiet(monkeypatch, **more)
    (handler,) = logger.handlers
    assert type(handler) is kind
    begun(logger)
    assert bool(stream.getvalue()) == (kind is logging.StreamHandler)


def test_warnings_and_errors_are_printed_and_the_console_follows(monkeypatch):
    logger, stream = quiet(monkeypatch)
    begun(logger)
    logger.warning("The lock is held")
    logger.error("MissingInputException: x", extra={"event": LogEvent.ERROR, "exception": "MissingInputException"})
    logger.info("Nothing to be done (all requested files are present and up to date).")
    assert stream.getvalue().splitlines() == [
        "The lock is held",
        "MissingInputException: x",
        "Nothing to be done (all requested files are present and up to date).",
    ]
    install_console(logger, [], 1, dict, "logs", False)
    (handler,) = logger.handlers
    assert isinstance(handler, Console) and isinstance(handler.inner, logging.StreamHandler)
    handler.close()


def job(number, rule, reason, *files):
    keys = {"jobid": number, "rule_name": rule, "output": list(files), "threads": 1, "reason": reason}
    return {"event": LogEvent.JOB_INFO, **keys}


def test_dry_run_has_a_line_for_each_stage(monkeypatch):
    monkeypatch.setattr(startup, "slowdown", lambda cores: 1.0)
    logger, stream = quiet(monkeypatch, dryrun=True)
    begun(logger)
    (handler,) = logger.handlers
    handler.cores, handler.folder = lambda: 2, "results"
    handler.expected = lambda: {"clean.h5": (100.0, 100.0)}
    logger.info("g", extra={"event": LogEvent.GROUP_INFO})
    changed = "Updated input files: my.yaml, ct.nii.gz; Params have changed since last execution"
    logger.info("1", extra=job(1, "project", changed, "clean.h5"))
    for seed in (0, 1):
        follows = f"Missing output files: {seed}.csv; Input files updated by another job: clean.h5"
        logger.info("2", extra=job(2 + seed, f"extract_{seed}", follows, f"{seed}.csv", f"{seed}.txt"))
    logger.info("3", extra=job(9, "all", "Input files updated by another job: 1.csv"))
    logger.info("Would remove temporary output clean.h5")
    begun(logger)
    logger.info("Reasons:\n    (check individual jobs above for details)\n    forced:\n        project")
    logger.info("This was a dry-run (flag -n). The order of jobs does not reflect the order of execution.")
    assert stream.getvalue().splitlines() == [
        "3 jobs would run, over 1 min on 2 cores:",
        "  project     1  clean.h5",
        "  extract     2  0.csv and 1 more, ...",
        "Why: updated input files (1 job: my.yaml, ct.nii.gz); params have changed since last execution (1 job); "
        "missing output files (2 jobs)",
        "Results: results. Dry run: nothing was made. -p lists all files of each job.",
    ]
