"""Run a command for a person at a terminal: notes, one line for each error, no traceback unless it is asked for."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence

from .errors import InputError, printed

DEBUG = "--debug"
NOTES = logging.getLogger("virtual_phantom.notes")
PROGRESS_SECONDS = 5  # work that takes less is not reported
INTERRUPTED = 130  # exit code of a program that Ctrl-C stopped, by the shell's convention (128 + SIGINT)


def note(text: object) -> None:
    """Report something in the user's input that was skipped or interpreted, which is no error.

    Commands print each distinct note once, as a line that starts with "Note:". In a workflow's job it goes to the log
    file of the rule.
    """
    NOTES.warning("%s", InputError(text))  # on one line, as an error is


def progress(what: str, done: int, total: int) -> None:
    """Report how far long work is: in commands, a line on standard error every PROGRESS_SECONDS; in jobs nothing.

    Parameters
    ----------
    what : str
        The work, such as "reading regions".
    done, total : int
        Steps.
    """
    for handler in NOTES.handlers:
        if isinstance(handler, _Printer):
            handler.progress(what, done, total)


@contextlib.contextmanager
def printed_notes() -> Iterator[None]:
    """Print notes and progress to standard error while the block runs, each distinct note once."""
    handler = _Printer()
    NOTES.addHandler(handler)
    propagate, NOTES.propagate = NOTES.propagate, False
    try:
        yield
    finally:
        NOTES.removeHandler(handler)
        NOTES.propagate = propagate


class _Printer(logging.Handler):
    def __init__(self):
        super().__init__()
        self._seen: set[str] = set()
        self._work, self._reported = "", 0.0

    def emit(self, record: logging.LogRecord) -> None:
        if (text := record.getMessage()) not in self._seen:
            self._seen.add(text)
            print(f"Note: {text}", file=sys.stderr)

    def progress(self, what: str, done: int, total: int) -> None:
        now = time.monotonic()
        if what != self._work or done == 0:
            self._work, self._reported = what, now
        elif now - self._reported >= PROGRESS_SECONDS:
            self._reported = now
            print(f"{what}: {done} of {total}", file=sys.stderr, flush=True)


def run_command(command: Callable[[Sequence[str]], int], words: Sequence[str] | None = None) -> int:
    """Run a command line and turn every exception into an exit code and one line on standard error.

    Parameters
    ----------
    command : callable
        Takes the words of the command line without the program's name and without ``--debug``; returns the exit code.
    words : sequence of str, optional
        By default those of this process.

    Returns
    -------
    int
        What the command returns; 1 after an error, INTERRUPTED after Ctrl-C.
    """
    words = list(sys.argv[1:] if words is None else words)
    debug = DEBUG in words
    _show_any_character()
    try:
        with printed_notes():
            code = command([word for word in words if word != DEBUG])
            sys.stdout.flush()
            return code
    except InputError as error:
        if debug:
            traceback.print_exc()
        print(printed(error), file=sys.stderr)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe; Python would complain at exit again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError as error:
        print(f"Error: not enough memory ({str(error) or 'no more is available'})", file=sys.stderr)
    except Exception as error:
        if debug:
            traceback.print_exc()
        print(f"Error: {unexpected(error)}", file=sys.stderr)
    return 1


def unexpected(error: BaseException) -> str:
    """One line about an exception that no reader expected, with what the user can do about it."""
    reason = str(InputError(" ".join(str(error).split())))
    what = f"unexpected {type(error).__name__}" + (f": {reason}" if reason else "")
    return f"{what}; this is a fault of Virtual Phantom: report it with what the same command prints with {DEBUG}"


def _show_any_character() -> None:
    """Escape what the terminal's encoding cannot show, instead of stopping (names may hold any character)."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
