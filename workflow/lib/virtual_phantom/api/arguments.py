"""Checks of the arguments of public functions, and one-line messages for unexpected errors."""

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
from ..base.errors import InputError, did_you_mean
from ..base.home import expand_home

MOST = 10**6  # largest count: more voxels along an axis or more views do not fit into memory
P, T = ParamSpec("P"), TypeVar("T")


class UnexpectedError(RuntimeError):
    """An error of Virtual Phantom itself: one line that says what to report. `__cause__` is the original exception."""


def public(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function to raise InputError for invalid arguments, and UnexpectedError for internal errors."""
    signature = inspect.signature(function)
    names = [name for name, parameter in signature.parameters.items() if parameter.kind is not parameter.VAR_KEYWORD]

    @functools.wraps(function)
    def checked(*arguments: P.args, **named: P.kwargs) -> T:
        try:
            signature.bind(*arguments, **named)
        except TypeError as error:
            unknown = [] if len(names) < len(signature.parameters) else [name for name in named if name not in names]
            hint = f"; {did_you_mean(unknown[0], names, 'arguments')}" if unknown else ""
            raise InputError(f"{function.__name__}: {error}{hint}") from None
        try:
            return function(*arguments, **named)
        except (InputError, MemoryError):
            raise
        except Exception as error:
            raise UnexpectedError(f"{function.__name__}: {unexpected(error, 'the traceback above')}") from error

    return checked


def check_integer(value: object, name: str, least: int, most: int = MOST) -> int:
    """Check that a value is a whole number from `least` to `most`; NumPy integers are accepted."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool | np.bool_) or number < least:
        raise InputError(f"{name}: {_shown(value)} is not a whole number of at least {least}; give one")
    if number > most:
        raise InputError(f"{name}: {_shown(value)} is more than {most}; give less")
    return number


def check_positive(value: object, name: str) -> float:
    """Check that a value is a finite number above 0."""
    try:
        number = math.nan if isinstance(value, bool | np.bool_ | str | bytes) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number) or number <= 0:
        raise InputError(f"{name}: {_shown(value)} is not a number above 0; give one")
    return number


def check_three(values: object, name: str, each: Callable[[object, str], T]) -> tuple[T, T, T]:
    """Check that there are three values (z, y, x), and check each."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, Sequence) or isinstance(values, str | bytes) or len(values) != 3:
        raise InputError(f"{name}: {_shown(values)} is not three numbers (z, y, x); give three")
    return tuple(each(value, f"{name}[{index}]") for index, value in enumerate(values))


def check_pair(value: object, name: str, what: str) -> tuple:
    """Check that there are two values."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) != 2:
        raise InputError(f"{name}: {_shown(value)} is not a pair; give {what}")
    return tuple(value)


def check_path(value: object, name: str) -> str:
    """Check that a value is a path and return it as text; ``~`` is the home folder."""
    if not isinstance(value, str | os.PathLike) or not os.fspath(value) or "\0" in str(value):
        raise InputError(f"{name}: {_shown(value)} is not a path; give the path of a file or folder as text")
    return expand_home(str(Path(value)), name)


def check_text(value: object, name: str) -> str:
    """Check that a value is text."""
    if not isinstance(value, str):
        raise InputError(f"{name}: {_shown(value)} is not text; give a name as text")
    return value


def check_mapping(value: object, name: str, what: str) -> Mapping:
    """Check that a value is a mapping."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name}: {_shown(value)} is not a mapping; give {what}")
    return value


def check_sequence(value: object, name: str, what: str) -> list:
    """Check that there are several values and return them as a list."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(value, str | bytes | Mapping) or not hasattr(value, "__iter__"):
        raise InputError(f"{name}: {_shown(value)} is not a list; give a list of {what}")
    return list(value)


def plain(value: object) -> object:
    """Convert NumPy values, paths and tuples to types of YAML, for the schema."""
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value


def check_made_by(value: object, kind: type[T], name: str, maker: str) -> T:
    """Check that a value is of the type that another function returns."""
    if not isinstance(value, kind):
        raise InputError(f"{name}: is of type {type(value).__name__}; give what {maker} returns")
    return value


def _shown(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
