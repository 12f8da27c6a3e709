"""Undocumented parts of Snakemake that the workflow uses, which another version may lack.

A run of four small jobs checks attributes of `workflow` that the rules use, fields of records that progress reads, and
messages without an event.
"""

import inspect
import json
import re
import subprocess
import sys

import pytest
from snakemake.jobs import GroupJob
from test_rules import FILES
from workflow_runs import ROOT

from virtual_phantom.study.progress import snakemake_messages as messages
from virtual_phantom.study.progress import startup
from virtual_phantom.study.progress.console import SILENT_EVENTS, Console

SNAKEFILE = """
import atexit, json, operator
from snakemake.logging import logger
import logging

seen = {{"attributes": {{}}, "job": {{}}, "records": []}}
chains = json.loads({chains!r})


def look(file):
    for chain in chains[file]:
        try:
            seen["attributes"][chain] = repr(operator.attrgetter(chain)(workflow))
        except AttributeError as error:
            seen["attributes"][chain] = f"AttributeError: {{error}}"


look("common.smk")
look("diagnose.smk")
look("library.smk")


class Records(logging.Handler):
    def emit(self, record):
        fields = {{key: str(value) for key, value in vars(record).items()}}
        fields["event"] = None if getattr(record, "event", None) is None else str(record.event)
        seen["records"].append(fields)


logger.addHandler(Records())


configfile: "config.yaml"


onstart:
    look("progress.smk")
    for job in workflow.dag.needrun_jobs():
        needs = [other.rule.name for other in workflow.dag.dependencies.get(job, ())]
        made, logs = ([*map(str, files)] for files in (job.output, job.log))
        seen["job"][job.rule.name] = [bool(job.is_norun), job.jobid, job.threads, made, needs, logs]
    seen["handlers"] = [getattr(handler, "stream", None) in (sys.stdout, sys.stderr) for handler in logger.handlers]


atexit.register(lambda: open("seen.json", "w").write(json.dumps(seen)))


rule all:
    default_target: True
    input:
        "made",
        "left_out",
        "failed",
    localrule: True


rule first:
    output:
        temp("first"),
    script:
        "touch.py"


rule made:
    input:
        "first",
    output:
        "made",
    threads: 1
    script:
        "touch.py"


rule left_out:
    output:
        "left_out",
    script:
        "nothing.py"


rule failed:
    output:
        "failed",
    log:
        "failed.log",
    script:
        "fail.py"
"""
# Attributes of `workflow` by file: common.smk while the Snakefile is read, the other once jobs run.
USED = {
    "common.smk": ["configfiles", "current_basedir.get_path_or_uri", "is_main_process"],
    "library.smk": ["current_basedir.get_path_or_uri", "is_main_process", "output_settings"],
    "diagnose.smk": ["resource_settings.cores"],
    "fetch.smk": ["is_main_process"],
    "plan.smk": ["resource_settings.cores"],
    "progress.smk": [
        "cores",
        "dag.dependencies.get",
        "dag.needrun_jobs",
        "execution_settings.keep_going",
        "executor_plugin.name",
        "local_exec",
        "output_settings",
        "resource_settings.cores",
        "scheduler.job_rate_limiter",
    ],
}

# Printed for a rule with a group, and for a run that ends at its first failure.
ELSEWHERE = {"Group jobs: inactive (local execution)", "Shutting down, this might take some time."}
DOCUMENTED = {"source_path"}  # on Snakemake's own pages


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Records and output of a run."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "Snakefile").write_text(SNAKEFILE.format(chains=json.dumps(USED)))
    (folder / "touch.py").write_text("open(snakemake.output[0], 'w').close()\n")
    (folder / "nothing.py").write_text("")
    (folder / "fail.py").write_text("raise SystemExit(1)\n")
    (folder / "config.yaml").write_text("word: 1\n")
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--keep-going", "--latency-wait", "0"]
    command += ["--config", "word=2"]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert process.returncode == 1, process.stderr[-3000:]
    return json.loads((folder / "seen.json").read_text())


def records(seen, event):
    found = [record for record in seen["records"] if record["event"] == event]
    assert found, f"no record of {event}"
    return found


def test_attributes_used_by_rules_exist(seen):
    assert seen["attributes"].keys() == {chain for chains in USED.values() for chain in chains}
    assert not {chain: found for chain, found in seen["attributes"].items() if "AttributeError" in found}
    assert seen["attributes"]["is_main_process"] == "True" and seen["attributes"]["cores"] == "1"
    assert seen["attributes"]["resource_settings.cores"] == "1"


def test_rules_use_no_other_attributes():
    found = {}
    for path in FILES:
        code = re.sub(r"#.*|\"[^\"\n]*\"", "", path.read_text())
        if chains := set(re.findall(r"\bworkflow\.([a-z_.]+)", code)) - DOCUMENTED:
            found[path.name] = sorted(chains)
    assert found == USED


def test_job_records_have_outputs_and_dependencies(seen):
    jobs = seen["job"]
    assert {name: job[0] for name, job in jobs.items()} == {name: name == "all" for name in jobs} and len(jobs) == 5
    assert len({job[1] for job in jobs.values()}) == 5
    assert jobs["made"][2:] == [1, ["made"], ["first"], []] and jobs["failed"][-1] == ["failed.log"]


def test_one_handler_writes_to_the_terminal(seen):
    assert seen["handlers"].count(True) == 1


def test_records_have_the_expected_fields(seen):
    numbers = {name: str(job[1]) for name, job in seen["job"].items()}
    assert {record["jobid"] for record in records(seen, "job_info")} >= {numbers[name] for name in ("first", "failed")}
    assert {record["job_id"] for record in records(seen, "job_finished")} == {numbers["first"], numbers["made"]}
    (failed,) = records(seen, "job_error")
    assert (failed["jobid"], failed["rule_name"], failed["indent"]) == (numbers["failed"], "failed", "False")
    assert failed["log"] == "['failed.log']" and failed["output"] == "['failed']"
    exceptions = [record["exception"] for record in records(seen, "error")]
    assert exceptions.count("RuleException") == exceptions.count("MissingOutputException") == 1
    assert exceptions[-1] == "WorkflowError"
    (before,) = [record for record in records(seen, "error") if record["exception"] == "RuleException"]
    assert before["thread"] == failed["thread"]


def test_group_records_have_the_expected_fields():
    """Groups occur on clusters only."""
    source = inspect.getsource(GroupJob)
    for field in ("LogEvent.GROUP_INFO", "jobs=", "LogEvent.GROUP_ERROR", "aux_logs=", "job_error_info="):
        assert field in source, field


def test_events_have_the_expected_names():
    from snakemake_interface_logger_plugins.common import LogEvent

    events = {"job_info", "job_finished", "job_error", "group_info", "group_error", "error"}
    assert events | SILENT_EVENTS | startup.SILENT_EVENTS <= {str(event) for event in LogEvent}
    assert all(hasattr(Console, f"_{event}") for event in events)


def test_messages_without_event_have_the_expected_text(seen):
    texts = [record["msg"] for record in seen["records"] if record["event"] is None]
    for beginning in {*messages.HIDDEN, *messages.HIDDEN_AT_STARTUP} - ELSEWHERE:
        assert any(text.startswith(beginning) for text in texts), beginning
    modules = ("snakemake.workflow", "snakemake.dag", "snakemake.scheduling.job_scheduler")
    sources = "".join(inspect.getsource(sys.modules[name]) for name in modules)
    for text in (*ELSEWHERE, *messages.DRY_RUN, messages.DRY_RUN_ENDS):
        assert f'"{text}' in sources, text
    errors = {record["exception"]: record["msg"] for record in records(seen, "error")}
    assert messages.INCOMPLETE in errors["WorkflowError"]
    assert messages.ENDED_BY.search(errors["RuleException"])[2] == "1"
    assert messages.FILES_MISSING.search(errors["MissingOutputException"])[1] == str(seen["job"]["left_out"][1])


def test_snakemakes_texts_are_in_one_file():
    folder = ROOT / "workflow" / "lib" / "virtual_phantom" / "study" / "progress"
    known = [
        *messages.HIDDEN,
        *messages.HIDDEN_AT_STARTUP,
        *messages.DRY_RUN,
        messages.DRY_RUN_ENDS,
        messages.INCOMPLETE,
    ]
    known += ["output files are missing", "returned non-zero exit status"]
    for path in folder.glob("*.py"):
        if path.name != "snakemake_messages.py":
            assert not [text for text in known if text in path.read_text()], path.name
