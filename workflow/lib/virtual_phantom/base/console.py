"""Command-line entry point: notes, one line per error, and a traceback only with --debug."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence

from .errors import InputError, printed
from .home import expand_home_of_word

DEBUG = "--debug"
NOTES = logging.getLogger("virtual_phantom.notes")
PROGRESS_SECONDS = 5  # shorter work is not reported
# Errors of the system that are not faults of a program: access, disks that are full or fail, and limits.
SYSTEM_ERRORS = {
    **dict.fromkeys((errno.EACCES, errno.EPERM), "change its permissions, or use another file or folder"),
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free some space and run again"),
    **dict.fromkeys((errno.EIO, errno.ESTALE), "check the disk and run again"),
    errno.EROFS: "use another folder",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENAMETOOLONG: "give shorter names",
}
INTERRUPTED = 130  # exit code of a program that Ctrl-C stopped, by the shell's convention (128 + SIGINT)


def note(text: object) -> None:
    """Report that input was skipped or interpreted, which is not an error.

    Commands print each distinct note once, as a line that starts with "Note:". Jobs of the workflow write notes to the
    log file of the rule.
    """
    NOTES.warning("%s", InputError(text))  # on one line, like an error


def progress(what: str, done: int, total: int) -> None:
    """Print the progress of long work to standard error every PROGRESS_SECONDS in commands; do nothing in jobs."""
    for handler in NOTES.handlers:
        if isinstance(handler, _Printer):
            handler.progress(what, done, total)


@contextlib.contextmanager
def printed_notes() -> Iterator[None]:
    """Print notes and progress to standard error in this block, each distinct note once."""
    handler = _Printer()
    NOTES.addHandler(handler)
    propagate, NOTES.propagate = NOTES.propagate, False
    try:
        yield
    finally:
        NOTES.removeHandler(handler)
        NOTES.propagate = propagate


@contextlib.contextmanager
def collected_notes() -> Iterator[list[str]]:
    """Collect the notes of this block, in addition to printing or logging them."""
    collector = _Collector()
    NOTES.addHandler(collector)
    try:
        yield collector.notes
    finally:
        NOTES.removeHandler(collector)


class _Collector(logging.Handler):
    def __init__(self):
        super().__init__()
        self.notes: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.notes.append(record.getMessage())


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

    The result is the exit code of the command, 1 after an error, or INTERRUPTED after Ctrl-C.

    Parameters
    ----------
    command : callable
        Takes the arguments without ``--debug`` and returns the exit code.
    words : sequence of str, optional
        Arguments; by default those of this process.
    """
    words = list(sys.argv[1:] if words is None else words)
    debug = DEBUG in words
    show_any_character()
    try:
        check_current_folder()
        with printed_notes():
            code = command([_checked(word) for word in words if word != DEBUG])
            sys.stdout.flush()
            return code
    except InputError as error:
        if debug:
            traceback.print_exc()
        print(printed(error), file=sys.stderr)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe; avoids a second error at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError as error:
        print(f"Error: not enough memory ({str(error) or 'no more is available'})", file=sys.stderr)
    except Exception as error:
        if debug:
            traceback.print_exc()
        print(f"Error: {unexpected(error)}", file=sys.stderr)
    return 1


def _checked(word: str) -> str:
    """Return an argument with ``~`` expanded. Line breaks are refused, because file lists have one path per line."""
    if len(word.splitlines()) > 1:
        raise InputError(f"{word}: contains a line break; rename the file or folder")
    check_names(word)
    return expand_home_of_word(word)


def unexpected(error: BaseException, beside: str = f"what the same command prints with {DEBUG}") -> str:
    """Return one line about an unexpected exception; `beside` says what a bug report needs in addition to this line."""
    if isinstance(error, UnicodeEncodeError):
        return _unencodable(error)
    if isinstance(error, OSError) and error.errno in SYSTEM_ERRORS:
        where = "" if error.filename is None else f"{InputError(error.filename)}: "
        return f"{where}{error.strerror}; {SYSTEM_ERRORS[error.errno]}"
    reason = str(InputError(" ".join(str(error).split())))
    what = f"unexpected {type(error).__name__}" + (f": {reason}" if reason else "")
    return f"{what}; this is a fault of Virtual Phantom: report it with {beside}"


def _unencodable(error: UnicodeEncodeError) -> str:
    """Return one line about text that cannot be encoded, such as a file name in a locale without UTF-8."""
    around = error.object[max(0, error.start - 30) : error.end + 30]
    encoding = sys.getfilesystemencoding()
    return f"{ascii(around)}: this name does not fit the encoding of the locale ({encoding}); set PYTHONUTF8=1"


def check_names(*names: str) -> None:
    """Check that names, or texts that contain names, can be encoded as file names and as UTF-8, for lists of files.

    Raises
    ------
    InputError
        If a name cannot be encoded.
    """
    try:
        for name in names:
            name.encode(sys.getfilesystemencoding())
            name.encode("utf-8")  # fails for surrogates, which represent bytes outside of the locale's encoding
    except UnicodeEncodeError as error:
        raise InputError(_unencodable(error)) from None


def check_current_folder() -> None:
    """Check that the current folder exists.

    Raises
    ------
    InputError
        If it was deleted or cannot be entered, so that relative paths have no meaning.
    """
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(f"the current folder cannot be used ({error.strerror}); change to another folder") from None


def show_any_character() -> None:
    """Escape characters that the terminal's encoding cannot show (names may contain any character)."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure") and stream.errors != "backslashreplace":
            stream.reconfigure(errors="backslashreplace")
