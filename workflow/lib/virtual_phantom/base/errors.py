"""The exception for bad input, as opposed to faults of the program."""

import contextlib
import difflib
from collections.abc import Iterable, Iterator


class InputError(ValueError):
    """Bad input. The message is one line: the file or key, what is wrong, and what to do.

    Characters that cannot be printed, which names in the input may contain, are escaped.
    """

    def __init__(self, message: object):
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(message)))


class InputErrors(InputError):
    """Several mistakes: `lines` has one line for each. The message is the first line and the number of others."""

    def __init__(self, lines: Iterable[str]):
        self.lines = tuple(str(InputError(line)) for line in lines)
        more = len(self.lines) - 1
        super().__init__(self.lines[0] + (f" (and {more} more)" if more else ""))


def lines_of(error: InputError) -> tuple[str, ...]:
    """Return one line for each mistake of an error."""
    return getattr(error, "lines", (str(error),))


def printed(error: InputError) -> str:
    """Return the text that is printed for an error: one line, or a numbered list."""
    lines = lines_of(error)
    if len(lines) == 1:
        return f"Error: {lines[0]}"
    return "\n".join(
        [f"Error: {len(lines)} mistakes", *(f"{number:>3}. {line}" for number, line in enumerate(lines, start=1))]
    )


def did_you_mean(name: str, choices: Iterable[str], otherwise: str = "known") -> str:
    """Return a hint for an unknown name: the most similar choice, or else `otherwise` and all choices."""
    choices = list(choices)
    close = difflib.get_close_matches(str(name), choices, 1)
    return f"did you mean '{close[0]}'?" if close else f"{otherwise}: {', '.join(choices) or 'none'}"


@contextlib.contextmanager
def refusing(what: str, *kinds: type[Exception], advice: str = "", quoted: bool = True) -> Iterator[None]:
    """Turn exceptions of these kinds into an InputError: `what`, the reason in parentheses, and advice.

    An InputError passes unchanged, although it is a ValueError.

    Parameters
    ----------
    what : str
        Beginning of the message: the file or key, and what is wrong.
    *kinds : type of Exception
        Exceptions to convert.
    quoted : bool, optional
        True: the reason is the text of the exception. False: its type.

    Raises
    ------
    InputError
        For any exception of these kinds in the block.
    """
    try:
        yield
    except InputError:
        raise
    except kinds as error:
        reason = " ".join(str(error).split()) if quoted else type(error).__name__
        raise InputError(f"{what} ({reason})" + (f"; {advice}" if advice else "")) from error


@contextlib.contextmanager
def reading(source: object, kind: str) -> Iterator[None]:
    """Turn any exception of a reader into an InputError with the file and its expected format.

    The text of the exception is not shown: for a broken header it may contain a patient's name.

    Parameters
    ----------
    source : object
        File or folder, for the message.
    kind : str
        Expected format, such as "DICOM SEG".

    Raises
    ------
    InputError
        For any exception in the block.
    """
    # Third-party readers raise many types of exceptions.
    with refusing(f"{source}: cannot be read as {kind}", Exception, advice="is the file complete?", quoted=False):
        yield


@contextlib.contextmanager
def naming(source: object) -> Iterator[None]:
    """Begin the message of an InputError with the file or key that it is about, unless it does already.

    Raises
    ------
    InputError
        For any InputError in the block.
    """
    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(str(source)) else InputError(f"{source}: {error}") from error
