"""What one kind of change does for a fit, and a piece of the object as one of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PieceOfObject:
    """A piece of the object that may differ from what was stated.

    Attributes
    ----------
    words : str
        What it is, after "what is left".
    content : mapping
        What diagnosis.json holds of it.
    directions : ndarray, shape (mean data, 1)
        Path lengths in it, mm.
    """

    words: str
    content: Mapping
    directions: np.ndarray


@dataclass(frozen=True)
class Change:
    """What one kind of change does for a fit.

    Attributes
    ----------
    words : str
        Of the kind, after "what is left".
    z : float
        Of the residual held out, along the direction that the data fitted say.
    p : float
        Chance of such a z without any such change.
    gain : float
        Log score of the data held out that the change would add, its size shrunk for what noise alone gives
        (W. James and C. Stein, Proc. 4th Berkeley Symp. 1, 361, 1961).
    piece : PieceOfObject or None
        Where it is one of the object.
    """

    words: str
    z: float
    p: float
    gain: float
    piece: PieceOfObject | None = None
