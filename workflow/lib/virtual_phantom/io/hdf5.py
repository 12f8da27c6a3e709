"""New HDF5 files, made in memory and written in one piece.

HDF5 writes as it goes and once more when it closes; where the disk is full then, h5py is left with a file that it can
neither close nor forget, and the process ends in a crash instead of a message.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import h5py

from .files import replacing


@contextlib.contextmanager
def new_file(path: str | Path) -> Iterator[h5py.File]:
    """Open an empty HDF5 file to fill; what it holds replaces `path` if the block succeeds.

    Raises
    ------
    InputError
        If the disk is full or the folder may not be written to.
    """
    with replacing(path) as temporary:
        with h5py.File(temporary.name, "w", driver="core", backing_store=False) as file:
            yield file
            file.flush()
            content = file.id.get_file_image()
        temporary.write_bytes(content)
