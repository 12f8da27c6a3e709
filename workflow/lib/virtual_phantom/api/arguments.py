"""Arguments of the public functions: checked by name, and unexpected errors, in one line."""

from __future__ import annotations

import functools
import inspect
import math
import operator
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np

from ..base.console import unexpected
from ..base.errors import InputError, meant
from ..base.home import expand_home

MOST = 10**6  # of anything that is counted here: more voxels along an axis or more views fit no memory
P, T = ParamSpec("P"), TypeVar("T")


class UnexpectedError(RuntimeError):
    """A fault of Virtual Phantom, in one line with what to report. Its `__cause__` is the exception itself."""


def public(function: Callable[P, T]) -> Callable[P, T]:
    """The function, which raises InputError for arguments that it does not take, and UnexpectedError for a fault."""
    signature = inspect.signature(function)
    names = [name for name, one in signature.parameters.items() if one.kind is not one.VAR_KEYWORD]

    @functools.wraps(function)
    def checked(*arguments: P.args, **named: P.kwargs) -> T:
        try:
            signature.bind(*arguments, **named)
        except TypeError as error:
            unknown = [] if len(names) < len(signature.parameters) else [name for name in named if name not in names]
            hint = f"; {meant(unknown[0], names, 'arguments')}" if unknown else ""
            raise InputError(f"{function.__name__}: {error}{hint}") from None
        try:
            return function(*arguments, **named)
        except (InputError, MemoryError):
            raise
        except Exception as error:
            raise UnexpectedError(f"{function.__name__}: {unexpected(error, 'the traceback above')}") from error

    return checked


def whole(value: object, name: str, least: int, most: int = MOST) -> int:
    """A whole number between two, which may be NumPy's."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool | np.bool_) or number < least:
        raise InputError(f"{name}: {_shown(value)} is not a whole number of at least {least}; give one")
    if number > most:
        raise InputError(f"{name}: {_shown(value)} is more than {most}; give less")
    return number


def positive(value: object, name: str) -> float:
    """A finite number above 0."""
    if isinstance(value, bool | np.bool_ | str | bytes):
        number = math.nan
    else:
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
    if not math.isfinite(number) or number <= 0:
        raise InputError(f"{name}: {_shown(value)} is not a number above 0; give one")
    return number


def three(values: object, name: str, each: Callable[[object, str], T]) -> tuple[T, T, T]:
    """Three values (z, y, x), each checked."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, Sequence) or isinstance(values, str | bytes) or len(values) != 3:
        raise InputError(f"{name}: {_shown(values)} is not three numbers (z, y, x); give three")
    return tuple(each(value, f"{name}[{index}]") for index, value in enumerate(values))


def pair(value: object, name: str, what: str) -> tuple:
    """Two values."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != 2:
        raise InputError(f"{name}: {_shown(value)} is not a pair; give {what}")
    return tuple(value)


def path(value: object, name: str) -> str:
    """The path of a file or folder, as text; ``~`` is the home folder."""
    if not isinstance(value, str | os.PathLike) or not os.fspath(value) or "\0" in str(value):
        raise InputError(f"{name}: {_shown(value)} is not a path; give the path of a file or folder as text")
    return expand_home(str(Path(value)), name)


def text(value: object, name: str) -> str:
    """Text."""
    if not isinstance(value, str):
        raise InputError(f"{name}: {_shown(value)} is not text; give a name as text")
    return value


def mapping(value: object, name: str, what: str) -> Mapping:
    """A mapping."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name}: {_shown(value)} is not a mapping; give {what}")
    return value


def sequence(value: object, name: str, what: str) -> list:
    """Several values, as a list."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(value, str | bytes | Mapping) or not hasattr(value, "__iter__"):
        raise InputError(f"{name}: {_shown(value)} is not a list; give a list of {what}")
    return list(value)


def made_by(value: object, kind: type[T], name: str, maker: str) -> T:
    """What another function has made."""
    if not isinstance(value, kind):
        raise InputError(f"{name}: is of type {type(value).__name__}; give what {maker} returns")
    return value


def _shown(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
