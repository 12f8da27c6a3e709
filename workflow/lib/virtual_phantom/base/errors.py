"""The one exception that means: the user's input is at fault, not the program."""

import contextlib
import difflib
from collections.abc import Iterable, Iterator


class InputError(ValueError):
    """Bad input. The message is one line: the file or key, what is wrong with it, and what to do.

    Characters that do not print, which names in the input may hold, are escaped: a line stays a line.
    """

    def __init__(self, message: object):
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(message)))


class InputErrors(InputError):
    """Several mistakes at once.

    As text the first of them, and how many more there are.

    Attributes
    ----------
    lines : tuple of str
        All of them, a line each.
    """

    def __init__(self, lines: Iterable[str]):
        self.lines = tuple(str(InputError(line)) for line in lines)
        more = len(self.lines) - 1
        super().__init__(self.lines[0] + (f" (and {more} more)" if more else ""))


def lines_of(error: InputError) -> tuple[str, ...]:
    """All that an error says, a line for each mistake."""
    return getattr(error, "lines", (str(error),))


def printed(error: InputError) -> str:
    """What is printed of an error: one line, or a numbered list."""
    lines = lines_of(error)
    if len(lines) == 1:
        return f"Error: {lines[0]}"
    return "\n".join(
        [f"Error: {len(lines)} mistakes", *(f"{number:>3}. {line}" for number, line in enumerate(lines, start=1))]
    )


def meant(name: str, choices: Iterable[str], otherwise: str = "known") -> str:
    """What to say of a name that is none of the choices.

    Parameters
    ----------
    name : str
        What the user wrote.
    choices : iterable of str
        What would have been right.
    otherwise : str, optional
        What precedes the list of all choices.

    Returns
    -------
    str
        The choice nearest to the name as a question; where none is near, all of them after `otherwise`.
    """
    choices = list(choices)
    close = difflib.get_close_matches(str(name), choices, 1)
    return f"did you mean '{close[0]}'?" if close else f"{otherwise}: {', '.join(choices) or 'none'}"


@contextlib.contextmanager
def refusing(what: str, *kinds: type[Exception], advice: str = "", quoted: bool = True) -> Iterator[None]:
    """Turn exceptions of these kinds into an InputError: `what` is wrong, the reason in brackets, and what to do.

    An InputError passes as it is, though it is a ValueError: it says already what is wrong.

    Parameters
    ----------
    what : str
        Beginning of the message: the file or key, and what is wrong with it.
    *kinds : type of Exception
        Which exceptions to turn.
    quoted : bool, optional
        True: the reason is what the exception says; False: its type alone.

    Raises
    ------
    InputError
        For any exception of these kinds within the block.
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
    """Turn whatever a reader raises on a broken file into an InputError that names the file and what it should be.

    What the reader says is left out: of a broken header it may quote all that follows, a patient's name too.

    Parameters
    ----------
    source : object
        The file or folder, for the message.
    kind : str
        What it should be, such as "DICOM SEG".

    Raises
    ------
    InputError
        For any exception within the block.
    """
    # Readers of others' formats raise many types.
    with refusing(f"{source}: cannot be read as {kind}", Exception, advice="is the file complete?", quoted=False):
        yield
