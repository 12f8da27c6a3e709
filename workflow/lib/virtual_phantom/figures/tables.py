"""Checks of the tables that figures are drawn from."""

from collections.abc import Iterable

import numpy as np
import pandas

from ..base.errors import InputError


def check_table(table: pandas.DataFrame, name: str, *, text: Iterable[str] = (), numbers: Iterable[str] = ()) -> None:
    """Raise InputError if a table lacks columns or rows, or has values in the columns `numbers` that are not finite."""
    text, numbers = list(text), list(numbers)
    absent = [column for column in text + numbers if column not in table.columns]
    if absent:
        raise InputError(f"{name}: lacks the column {', '.join(absent)}; make the table again")
    if table.empty:
        raise InputError(f"{name}: has no rows; check the job that makes it")
    for column in numbers:
        values = pandas.to_numeric(table[column], errors="coerce").to_numpy(dtype=float)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise InputError(
                f"{name}: column {column} is not a finite number in row {row + 1} "
                f"({table[column].iloc[row]}); check the job that makes it"
            )
