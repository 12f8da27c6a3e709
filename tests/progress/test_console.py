"""Console output of a run, with records as Snakemake logs them and a clock that the test sets."""

import io
import logging
import re
import signal
import sys
import time

import pytest
from snakemake.logging import DefaultFormatter
from snakemake_interface_logger_plugins.common import LogEvent

from virtual_phantom.base.errors import InputError
from virtual_phantom.study.job import job
from virtual_phantom.study.progress import console, status
from virtual_phantom.study.progress.console import Console
from virtual_phantom.study.progress.failures import described
from virtual_phantom.study.progress.status import duration, duration_range
from virtual_phantom.study.progress.time_left import Progress, Step


class Run:
    """A run of `jobs` jobs of one rule, at a time that the test sets."""

    def __init__(self, jobs=3, seconds=60.0, keep_going=False):
        self.now, self.stream = 1000.0, io.StringIO()
        inner = logging.StreamHandler(self.stream)
        inner.setFormatter(DefaultFormatter(quiet=set(), show_failed_logs=True))
        steps = [Step(i, f"reconstruct_{i}", (f"images/{i}.nii.gz",)) for i in range(jobs)]
        expected = {step.files[0]: seconds for step in steps}
        progress = Progress(steps, 1, lambda: expected, self.now)
        self.console = Console(inner, progress, "results/logs", keep_going, lambda: self.now)

    def log(self, event, message="", level=logging.INFO, **more):
        record = logging.makeLogRecord({"msg": message, "levelno": level, "event": event, **more})
        self.console.emit(record)

    def lines(self):
        """Printed lines, without the time at their start."""
        return [line[9:] if line[2:3] == line[5:6] == ":" else line for line in self.stream.getvalue().splitlines()]


def failed(run, number=0, logs=(), **more):
    keys = {"rule_name": f"reconstruct_{number}", "rule_msg": None, "jobid": number, "input": ["clean.h5"]}
    keys |= {"output": [f"images/{number}.nii.gz", "images/b.nii.gz"], "log": [str(log) for log in logs]}
    keys |= {"conda_env": None, "shellcmd": None, "aux": {}, "indent": False} | more
    return keys


def ended(run):
    run.log(
        LogEvent.ERROR, "WorkflowError:\nAt least one job did not complete successfully.", exception="WorkflowError"
    )


def exited_with_1(run):
    exception_text = (
        "RuleException:\nCalledProcessError in file \"r.smk\", line 4:\nCommand 'x' returned non-zero exit status 1."
    )
    run.log(LogEvent.ERROR, exception_text, logging.ERROR, exception="RuleException")


class Script:
    """Snakemake's object of a script."""

    def __init__(self, log):
        self.log, self.threads = [log], 1


def written(log, error):
    """Log of a failed job."""
    with pytest.raises((SystemExit, type(error))), job(Script(log)):
        raise error
    return log


def test_successful_run():
    run = Run()
    run.log(None, "Select jobs to execute...")
    run.log(LogEvent.JOB_INFO, jobid=0, rule_name="reconstruct_0")
    for number, seconds in enumerate((120.0, 120.0, 120.0)):
        run.now += seconds
        run.log(LogEvent.JOB_FINISHED, job_id=number)
        run.log(LogEvent.PROGRESS, done=number + 1, total=3)
        if number < 2:
            run.log(LogEvent.JOB_INFO, jobid=number + 1, rule_name=f"reconstruct_{number + 1}")
    run.log(None, "Complete log(s): x.log")
    assert run.lines() == [
        "Jobs to do: 3, 1.5 to 10 min on 1 core. Logs: results/logs",
        "0 of 3 jobs done; now: reconstruct (0 of 3 done)",
        "1 of 3 jobs done, 2 to 6 min left; now: reconstruct (1 of 3 done)",
        "2 of 3 jobs done, 1 to 3 min left; now: reconstruct (2 of 3 done)",
        "3 of 3 jobs done in 6 min",
        "Complete log(s): x.log",
    ]


def test_last_line_names_the_first_page():
    stream = io.StringIO()
    steps = [Step(0, "extract", ("features.csv",)), Step(1, "index_page", ("results/index.html",))]
    one = Console(logging.StreamHandler(stream), Progress(steps, 1, lambda: {}, 1000.0), "logs", clock=lambda: 1007.0)
    for number in (0, 1):
        one.emit(logging.makeLogRecord({"event": LogEvent.JOB_INFO, "jobid": number}))
        one.emit(logging.makeLogRecord({"event": LogEvent.JOB_FINISHED, "job_id": number}))
    assert stream.getvalue().splitlines()[-1].endswith("2 of 2 jobs done in 7 s. Start with results/index.html")


def test_many_jobs_have_few_lines():
    """Two thousand jobs in ten hours: several lines in the first minutes, then ever fewer."""
    run = Run(2000)
    for number in range(2000):
        run.log(LogEvent.JOB_INFO, jobid=number, rule_name="reconstruct_0")
        run.now += 18.0
        run.log(LogEvent.JOB_FINISHED, job_id=number)
    assert 50 < len(run.lines()) < 250


def test_last_line_states_the_failure_and_its_reason(tmp_path):
    run = Run()
    run.now = 0.0
    run.console.progress.began = 0.0
    log = written(tmp_path / "a.log", InputError("clean.h5: is cut short; delete it"))
    run.log(LogEvent.JOB_INFO, jobid=0, rule_name="reconstruct_0")
    exited_with_1(run)
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    run.log(None, "Exiting because a job execution failed. Look above for error messages", logging.ERROR)
    ended(run)
    assert run.lines()[-1] == (
        f"Failed: reconstruct of images/0.nii.gz and 1 more: clean.h5: is cut short; delete it (log: {log})"
    )
    assert run.lines()[1:3] == ["0 of 3 jobs done; now: reconstruct (0 of 3 done)", "0 of 3 jobs done, 1 failed"]
    assert len(run.lines()) == 4


def test_failure_is_printed_at_once_if_other_jobs_continue(tmp_path):
    run = Run()
    run.console.progress.began = 0.0
    log = written(tmp_path / "a.log", InputError("broken; mend it"))
    for number in (0, 1):
        run.log(LogEvent.JOB_INFO, jobid=number, rule_name=f"reconstruct_{number}")
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    assert "broken; mend it" in run.lines()[-1]


@pytest.mark.parametrize(
    "error, reason",
    [
        (
            ValueError("two\nlines"),
            "unexpected ValueError: two lines; this is a fault of Virtual Phantom: report it with the log",
        ),
        (MemoryError(), "not enough memory (no more is available); run fewer jobs at a time, or a smaller grid"),
    ],
)
def test_every_kind_of_failure_has_one_line(error, reason, tmp_path):
    run = Run()
    run.console.progress.began = 0.0
    log = written(tmp_path / "a.log", error)
    assert "Traceback" in log.read_text()
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    ended(run)
    assert run.lines()[-1] == f"Failed: reconstruct of images/0.nii.gz and 1 more: {reason} (log: {log})"


KILLED = "RuleException:\nCalledProcessError in file \"r.smk\", line 4:\nCommand 'x' {}"


OF_MEMORY = "most often because memory ran out; run with fewer --cores, or a smaller grid"
EARLY = "before its log began; see the lines above for the reason"


@pytest.mark.parametrize(
    "how, words",
    [
        ("died with <Signals.SIGKILL: 9>.", f"ended by SIGKILL, {OF_MEMORY}"),
        ("returned non-zero exit status 137.", f"ended by SIGKILL, {OF_MEMORY}"),
        (
            "died with <Signals.SIGTERM: 15>.",
            "ended by SIGTERM (stopped from outside or out of time); run the same command again to continue",
        ),
        (
            "died with <Signals.SIGBUS: 7>.",
            "ended by SIGBUS, most often because a disk or shared memory is full; free some space",
        ),
        (
            "died with <Signals.SIGSEGV: 11>.",
            "ended by SIGSEGV (a crash); run the command again, and report the log if it fails again",
        ),
        ("died with <Signals.SIGPIPE: 13>.", "ended by SIGPIPE; run the same command again"),
        ("returned non-zero exit status 1.", f"ended with exit status 1 {EARLY}"),
        ("returned non-zero exit status 200.", f"ended with exit status 200 {EARLY}"),
    ],
)
def test_script_without_a_reason_has_one_line(how, words, tmp_path):
    """Its inputs are not listed, and its log is of an earlier run."""
    run = Run()
    log = written(tmp_path / "a.log", InputError("of another day"))
    run.console.progress.began = log.stat().st_mtime + 1
    run.log(LogEvent.ERROR, KILLED.format(how), logging.ERROR, exception="RuleException")
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    ended(run)
    assert run.lines()[1:] == [
        "0 of 3 jobs done, 1 failed",
        f"Failed: reconstruct of images/0.nii.gz and 1 more: {words} (log: {log})",
    ]


def test_show_failed_logs_also_prints_snakemakes_block(tmp_path):
    run = Run()
    run.console.show_failed_logs = True
    run.log(LogEvent.ERROR, KILLED.format("died with <Signals.SIGKILL: 9>."), logging.ERROR, exception="RuleException")
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[tmp_path / "none.log"]))
    ended(run)
    text = run.stream.getvalue()
    assert text.index("died with <Signals.SIGKILL: 9>.") < text.index("Error in rule reconstruct_0:")
    assert run.lines()[-1].endswith(f"or a smaller grid (log: {tmp_path}/none.log)")


def test_exception_without_a_job_is_printed():
    run = Run()
    exited_with_1(run)
    ended(run)
    assert "returned non-zero exit status 1." in run.stream.getvalue()


def test_errors_of_the_console_do_not_end_the_run(capsys):
    """Missing rates are reported once; a failing terminal, each time."""
    run = Run()

    def none():
        raise OSError("no rates to be had")

    run.console.progress._expected, run.console.progress._rates = none, None
    logger = logging.Logger("a run")
    logger.addHandler(run.console)
    for number in range(3):
        logger.info("job", extra={"event": LogEvent.JOB_INFO, "jobid": number})
        run.now += 60.0
        logger.info("done", extra={"event": LogEvent.JOB_FINISHED, "job_id": number})
    assert capsys.readouterr().err.count("OSError: no rates to be had") == 1
    assert run.lines()[1:] == [
        "0 of 3 jobs done; now: reconstruct (0 of 3 done)",
        "2 of 3 jobs done, 40 s to 2 min left; now: reconstruct (2 of 3 done)",
        "3 of 3 jobs done in 3 min",
    ]
    run.stream.close()
    logger.info("done", extra={"event": LogEvent.JOB_FINISHED, "job_id": 2})
    assert "I/O operation on closed file" in capsys.readouterr().err


def test_restarted_job_has_not_failed(tmp_path):
    run = Run(2)
    run.console.progress.began = 0.0
    log = written(tmp_path / "a.log", InputError("broken; mend it"))
    run.log(LogEvent.JOB_INFO, jobid=0)
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    assert "Failed" not in run.stream.getvalue()
    run.log(None, "Trying to restart job 0.")
    assert run.lines()[-1] == "Trying to restart job 0."
    run.now += 60.0
    run.log(LogEvent.JOB_INFO, jobid=0)
    assert "broken; mend it" in run.lines()[-2]
    assert run.lines()[-1] == "0 of 2 jobs done, 1 to 6 min left; now: reconstruct (0 of 2 done)"
    run.log(LogEvent.JOB_FINISHED, job_id=0)
    run.log(LogEvent.JOB_INFO, jobid=1)
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, 1, logs=[tmp_path / "none.log"]))
    ended(run)
    last = run.lines()[-2:]
    assert last[0] == "1 of 2 jobs done, 1 failed" and last[1].startswith("Failed: reconstruct of images/1.nii.gz")


def test_after_a_failure_no_time_is_estimated_for_jobs_that_will_not_start(tmp_path):
    run = Run(3)
    for number in (0, 1):
        run.log(LogEvent.JOB_INFO, jobid=number)
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[tmp_path / "none.log"]))
    run.now += 30.0
    run.log("time_passed")
    assert run.lines()[-1] == "0 of 3 jobs done, 1 failed; no more are started; now: reconstruct (0 of 3 done)"


def test_keep_going_prints_failures_and_the_time_of_other_jobs(tmp_path):
    run = Run(3, keep_going=True)
    run.console.progress.began = 0.0
    log = written(tmp_path / "a.log", InputError("broken; mend it"))
    run.log(LogEvent.JOB_INFO, jobid=0)
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    assert "broken; mend it" in run.lines()[-1]
    run.now += 60.0
    run.log(LogEvent.JOB_INFO, jobid=1)
    assert run.lines()[-1] == "0 of 3 jobs done, 1 failed, 1 to 6 min left; now: reconstruct (0 of 3 done)"
    for number in (1, 2):
        run.log(LogEvent.JOB_FINISHED, job_id=number)
    ended(run)
    assert run.lines()[-2] == "2 of 3 jobs done, 1 failed"


def test_of_many_failures_the_first_ten_are_listed_at_the_end(tmp_path):
    run = Run(13)
    for number in range(13):
        run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, number, logs=[tmp_path / "none.log"]))
    ended(run)
    assert run.lines()[-11] == "Failed: 3 more jobs; the first failures were:"
    assert [line.split()[3] for line in run.lines()[-10:]] == [f"images/{number}.nii.gz" for number in range(10)]


def test_job_past_its_expected_time_may_take_as_long_again():
    run = Run(1)
    run.log(LogEvent.JOB_INFO, jobid=0)
    run.now += 100.0
    run.log("time_passed")
    assert run.lines()[-1] == "0 of 1 jobs done, under 1 min left; now: reconstruct (0 of 1 done)"


def test_job_with_missing_outputs_has_failed_and_its_group_too():
    """Snakemake only sends the exception."""
    run = Run(4, keep_going=True)
    jobs = [type("Job", (), {"jobid": number})() for number in (0, 1)]
    run.log(LogEvent.GROUP_INFO, jobs=jobs, group_id="g")
    for number in range(3):
        run.log(LogEvent.JOB_INFO, jobid=number)
    text = "MissingOutputException in rule x in file r.smk, line 3:\nJob {}  completed successfully, but some output "
    text += "files are missing. Missing files after 5 seconds:\nx (missing locally)"
    run.log(LogEvent.ERROR, text.format(1), logging.ERROR, exception="MissingOutputException")
    assert list(run.console.progress.under_way) == [2] and run.console.progress.failed == {0, 1}
    run.log(LogEvent.ERROR, text.format(2), logging.ERROR, exception="MissingOutputException")
    assert not run.console.progress.under_way
    ended(run)
    assert "Missing files after 5 seconds:" in run.stream.getvalue()
    assert run.lines()[-2:] == [
        f"Failed: reconstruct of images/{number}.nii.gz: no error, but files are missing; Snakemake's message "
        "names them"
        for number in (1, 2)
    ]


def test_jobs_that_only_list_files_are_not_counted():
    """Snakemake logs `all` like the others."""
    run = Run(1)
    run.log(LogEvent.JOB_INFO, jobid=0)
    run.log(LogEvent.JOB_FINISHED, job_id=0)
    run.log(LogEvent.JOB_INFO, jobid=99)
    run.log(LogEvent.JOB_FINISHED, job_id=99)
    assert run.lines()[2:] == ["1 of 1 jobs done in 0 s"]


def test_failed_job_of_a_group_is_named(tmp_path):
    run = Run()
    run.console.progress.began = 0.0
    log = written(tmp_path / "b.log", InputError("broken; mend it"))
    (tmp_path / "a.log").write_text("2026-01-01 00:00:00 INFO all is well\n")
    jobs = [failed(run, 0, [tmp_path / "a.log"]), failed(run, 1, [log]), failed(run, 2, [tmp_path / "none.log"])]
    run.log(LogEvent.GROUP_ERROR, "Error", logging.ERROR, groupid="g", aux_logs=["slurm.log"], job_error_info=jobs)
    for failure in jobs:
        run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failure | {"indent": True})
    ended(run)
    assert [line for line in run.lines() if "Failed" in line] == [
        f"Failed: reconstruct of images/1.nii.gz and 1 more: broken; mend it (log: {log})"
    ]


def test_acquisitions_are_named_by_level_and_seeds():
    names = [f"r/images/sirt_150/{level}/seed{seed:02d}.nii.gz" for level in ("dose10", "double") for seed in range(3)]
    job = {"rule_name": "reconstruct_0", "output": [*names, "r/images/sirt_150/half/seed07.nii.gz"]}
    assert described(job) == (
        "reconstruct of r/images/sirt_150/dose10/seed00 to seed02, r/images/sirt_150/double/seed00 to seed02, "
        "r/images/sirt_150/half/seed07"
    )
    assert described({"rule_name": "plan", "output": []}) == "plan"
    assert described({"rule_name": "pca", "output": ["a.csv"]}) == "pca of a.csv"


@pytest.fixture
def stopped():
    """Stop a run by a signal; Snakemake's own handler is replaced."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    received = []

    def stop(run, number):
        signal.signal(number, lambda *arguments: received.append(arguments[0]))
        run.console.catch_signals()
        signal.raise_signal(number)
        assert received == [number]

    yield stop
    for number, handler in before.items():
        signal.signal(number, handler)


def test_interruption_is_not_reported_as_failure(stopped):
    run = Run()
    run.log(LogEvent.JOB_INFO, jobid=0, rule_name="reconstruct_0")
    stopped(run, signal.SIGINT)
    run.log(None, "Terminating processes on user request, this might take some time.")
    killed = "RuleException:\nCalledProcessError\nCommand 'x' died with <Signals.SIGINT: 2>."
    run.log(LogEvent.ERROR, killed, logging.ERROR, exception="RuleException")
    run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run))
    ended(run)
    assert run.lines()[2:] == [
        "Terminating processes on user request, this might take some time.",
        "Stopped. Finished files are kept; run the same command again to continue.",
    ]


def test_errors_during_an_interruption_are_reported(stopped):
    run = Run()
    run.log(LogEvent.JOB_INFO, jobid=0)
    stopped(run, signal.SIGINT)
    run.log(None, "Terminating processes on user request, this might take some time.")
    refused = "WorkflowError:\nUnable to cancel jobs: scancel: permission denied"
    run.log(LogEvent.ERROR, refused, logging.ERROR, exception="WorkflowError")
    ended(run)
    assert run.lines()[-2:] == [
        "Unable to cancel jobs: scancel: permission denied",
        "Stopped. Finished files are kept; run the same command again to continue.",
    ]


@pytest.mark.parametrize("fails", [False, True])
def test_jobs_that_may_finish_after_sigterm_may_fail(fails, tmp_path, stopped):
    run = Run()
    run.console.progress.began = 0.0
    for number in (0, 1):
        run.log(LogEvent.JOB_INFO, jobid=number)
    stopped(run, signal.SIGTERM)
    for _ in range(2):
        run.log(None, "Will exit after finishing currently running jobs (scheduler).")
    run.now += 60.0
    run.log("time_passed")
    assert run.lines()[2:] == [
        "Will exit after finishing currently running jobs (scheduler).",
        "0 of 3 jobs done; no more are started; now: reconstruct (0 of 3 done)",
    ]
    if fails:
        log = written(tmp_path / "a.log", InputError("broken; mend it"))
        run.log(LogEvent.JOB_ERROR, "Error", logging.ERROR, **failed(run, logs=[log]))
    ended(run)
    assert ("broken; mend it" if fails else "Stopped. Finished files are kept") in run.lines()[-1]


def test_other_messages_are_snakemakes():
    run = Run()
    run.log(None, "The lock is held", logging.WARNING)
    run.log(LogEvent.ERROR, "MissingInputException: x", logging.ERROR, exception="MissingInputException")
    ended(run)
    assert run.lines()[1:3] == ["The lock is held", "MissingInputException: x"]
    assert run.lines()[-1] == "At least one job did not complete successfully."


@pytest.fixture
def install_console():
    """Function under test; the signal handlers are restored afterwards."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield console.install_console
    for number, handler in before.items():
        signal.signal(number, handler)


def test_only_the_terminal_handler_is_replaced(install_console, tmp_path):
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background process ignores it
    logger = logging.Logger("a run")
    others = [logging.StreamHandler(io.StringIO()), logging.FileHandler(tmp_path / "log"), logging.NullHandler()]
    for handler in others:
        logger.addHandler(handler)
    install_console(logger, [], 1, dict, "logs", False)
    assert logger.handlers == others
    logger.addHandler(logging.StreamHandler(sys.stderr))
    install_console(logger, [], 1, dict, "logs", False)
    assert logger.handlers[:-1] == others and isinstance(logger.handlers[-1], Console)
    assert signal.getsignal(signal.SIGINT).func == logger.handlers[-1]._stop


def test_ignored_signals_remain_ignored(install_console):
    """As in a background process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logger = logging.Logger("a run")
    logger.addHandler(logging.StreamHandler(sys.stderr))
    install_console(logger, [], 1, dict, "logs", False)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_time_passes_while_jobs_run(monkeypatch, install_console):
    monkeypatch.setattr(console, "TIMER_SECONDS", 0.01)
    monkeypatch.setattr(status, "SECONDS_BETWEEN", 0.01)
    stream, logger = io.StringIO(), logging.Logger("a run")
    monkeypatch.setattr(sys, "stderr", stream)
    logger.addHandler(logging.StreamHandler())
    install_console(logger, [Step(0, "phantom", ("a",))], 1, lambda: {"a": 3000.0}, "logs", False)
    logger.info("job", extra={"event": LogEvent.JOB_INFO, "jobid": 0})
    deadline = time.monotonic() + 20
    while stream.getvalue().count("0 of 1 jobs done") < 4 and time.monotonic() < deadline:
        time.sleep(0.01)
    # As in Snakemake: with the handler's lock, which the thread may be waiting for.
    (handler,) = logger.handlers
    handler.acquire()
    handler.close()
    handler.release()
    exception_text = stream.getvalue()
    handler._timer.join(20)
    assert not handler._timer.is_alive()
    assert re.search(r"0 of 1 jobs done, .* to .* h left; now: phantom \(0 of 1 done\)", exception_text)
    assert stream.getvalue() == exception_text and exception_text.count("0 of 1 jobs done") >= 4


@pytest.mark.parametrize(
    "low, high, words",
    [
        (65, 170, "1 to 3 min"),
        (42, 130, "40 s to 2.5 min"),
        (1, 4, "under 5 s"),
        (0, 0, ""),
        (5, 5, "about 5 s"),
        (3500, 9000, "50 min to 2.5 h"),
        (3600 * 30, 86400 * 7, "30 h to 8 days"),
        (90, 90 * 60, "1.5 min to 1.5 h"),
    ],
)
def test_ranges_are_round_numbers(low, high, words):
    assert duration_range(low, high) == words
    ends = {seconds for seconds, _, _ in status.ROUND_DURATIONS}
    assert len(ends) == len(status.ROUND_DURATIONS) and sorted(ends) == [
        seconds for seconds, _, _ in status.ROUND_DURATIONS
    ]


def test_unknown_job_times_leave_the_upper_end_open():
    assert duration_range(130, 600, False) == "over 2 min" and duration_range(2, 9, False) == ""


def test_durations_have_a_useful_precision():
    assert [duration(s) for s in (3.4, 89, 91, 3600, 7200)] == ["3 s", "89 s", "2 min", "60 min", "2.0 h"]
