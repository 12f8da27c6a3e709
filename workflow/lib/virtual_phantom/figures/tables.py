"""Read and check the tables that figures are drawn from."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas

from ..errors import InputError


def read_table(path: str | Path) -> pandas.DataFrame:
    """Read a CSV. Raises InputError if it is missing, empty or no table."""
    try:
        return pandas.read_csv(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; run the rule that makes it") from error
    except (ValueError, UnicodeDecodeError) as error:  # pandas' own errors on broken files are ValueErrors
        reason = str(error).splitlines()[0]
        raise InputError(f"{path}: cannot be read as a table ({reason}); delete it and run again") from error


def check_table(table: pandas.DataFrame, name: str, *, text: Iterable[str] = (), numbers: Iterable[str] = ()) -> None:
    """Raise InputError if a column is absent, there are no rows, or `numbers` are not all finite."""
    text, numbers = list(text), list(numbers)
    absent = [column for column in text + numbers if column not in table.columns]
    if absent:
        raise InputError(f"{name}: lacks the column {', '.join(absent)}; make the table anew")
    if table.empty:
        raise InputError(f"{name}: has no rows; there is nothing to draw, check the stage that makes it")
    for column in numbers:
        values = pandas.to_numeric(table[column], errors="coerce").to_numpy(dtype=float)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise InputError(
                f"{name}: column {column} is not a finite number in row {row + 1} "
                f"({table[column].iloc[row]}); check the stage that makes it"
            )
