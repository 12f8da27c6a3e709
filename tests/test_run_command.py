"""Commands end every exception in one line, print notes once, and escape names that the terminal cannot encode."""

import errno
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from virtual_phantom.base.console import DEBUG, INTERRUPTED, note, run_command
from virtual_phantom.base.errors import InputError, InputErrors

START = "from virtual_phantom.base.console import run_command\n"
LIBRARY = Path(__file__).resolve().parents[1] / "workflow" / "lib"


def raising(error):
    def command(words):
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (InputError("a.nii: is empty; give another"), "Error: a.nii: is empty; give another"),
        (InputErrors(["a: 1", "b: 2"]), "Error: 2 mistakes\n  1. a: 1\n  2. b: 2"),
        (MemoryError(), "Error: not enough memory (no more is available)"),
        (
            OSError(errno.ENOSPC, "No space left on device"),
            "Error: No space left on device; free some space and run again",
        ),
        (
            PermissionError(errno.EACCES, "Permission denied", "ct/a.dcm"),
            "Error: ct/a.dcm: Permission denied; change its permissions, or use another file or folder",
        ),
        (
            IndexError("tuple index\nout of range"),
            "Error: unexpected IndexError: tuple index out of range; this is a fault of Virtual Phantom: report it "
            "with what the same command prints with --debug",
        ),
    ],
)
def test_every_error_is_one_line(error, line, capsys):
    assert run_command(raising(error), []) == 1
    assert capsys.readouterr().err == line + "\n"


def test_debug_prints_the_traceback_before_the_line(capsys):
    assert run_command(raising(KeyError("x")), ["check", DEBUG]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("Traceback") and printed.splitlines()[-1].startswith("Error: unexpected KeyError: 'x'")


def test_interruption_has_the_exit_code_of_the_shell():
    assert run_command(raising(KeyboardInterrupt()), []) == INTERRUPTED


def test_each_note_is_printed_once_and_reaches_no_other_handler(capsys, caplog):
    def command(words):
        assert words == ["init"]
        note("a.dcm: skipped")
        note("a.dcm: skipped")
        note("two\nlines")
        return 3

    with caplog.at_level(logging.INFO):
        assert run_command(command, ["init", DEBUG]) == 3
    assert capsys.readouterr().err == "Note: a.dcm: skipped\nNote: two\\nlines\n" and not caplog.records


def test_outside_of_a_command_notes_are_log_records(caplog):
    note("a.dcm: skipped")
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [("WARNING", "a.dcm: skipped")]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_names_are_escaped_if_the_terminal_cannot_show_them(encoding):
    code = START + "run_command(lambda words: print('Zyste \u00df \u8102') or 0, [])"
    variables = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONPATH": str(LIBRARY)}
    run = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, check=True)
    shown = {"ascii": b"Zyste \\xdf \\u8102\n", "latin-1": b"Zyste \xdf \\u8102\n"}
    assert run.stdout == shown[encoding] and run.stderr == b""


def test_closed_pipe_is_no_error():
    code = START + "run_command(lambda words: print('x\\n' * 99999) or 0, [])"
    variables = os.environ | {"PYTHONPATH": str(LIBRARY)}
    with subprocess.Popen(
        [sys.executable, "-c", code], env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as run:
        run.stdout.readline()
        run.stdout.close()
        assert run.stderr.read() == b""
