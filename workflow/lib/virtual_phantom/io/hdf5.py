"""New HDF5 files, created in memory and written in one piece.

HDF5 writes while it runs and when it closes. On a full disk, h5py can then neither close nor discard the file, and the
process crashes without a message.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import h5py

from .files import replacing


@contextlib.contextmanager
def new_file(path: str | Path) -> Iterator[h5py.File]:
    """Open an empty HDF5 file for writing; it replaces `path` if the block succeeds.

    Raises
    ------
    InputError
        If the disk is full or the folder is not writable.
    """
    with replacing(path) as temporary:
        with h5py.File(temporary.name, "w", driver="core", backing_store=False) as file:
            yield file
            file.flush()
            content = file.id.get_file_image()
        temporary.write_bytes(content)
