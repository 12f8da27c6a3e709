"""Check the tables that figures are drawn from."""

from collections.abc import Iterable

import numpy as np
import pandas

from ..base.errors import InputError


def check_table(table: pandas.DataFrame, name: str, *, text: Iterable[str] = (), numbers: Iterable[str] = ()) -> None:
    """Check a table that a figure is drawn from.

    Parameters
    ----------
    name : str
        What the messages call it.
    text, numbers : iterable of str, optional
        Columns that it must have.

    Raises
    ------
    InputError
        If a column is absent, there are no rows, or `numbers` are not all finite.
    """
    text, numbers = list(text), list(numbers)
    absent = [column for column in text + numbers if column not in table.columns]
    if absent:
        raise InputError(f"{name}: lacks the column {', '.join(absent)}; make the table again")
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
