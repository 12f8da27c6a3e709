"""Functions that Numba compiles, with their machine code kept on disk: one file for each signature.

Numba's own cache (``njit(cache=True)``) keeps an index of signatures beside numbered data files and updates both
without a lock (`IndexDataCacheFile.save` of numba/core/caching.py). If two processes compile two signatures of one
function at the same time, one signature can be paired with the code of the other. That code then runs with arguments
that it was not compiled for. Here each file name contains a hash of everything that the code depends on, so no index is
needed. A file is written under a temporary name and renamed, which is atomic on network file systems, too. It begins
with a hash of its key and content: code that is damaged, truncated or of another key is compiled again, not run.
"""

from __future__ import annotations

import errno
import hashlib
import os
import pickle
import sys
import uuid
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import llvmlite
import numba
from numba.core.caching import NullCache, _Cache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

from .cache_folders import temporary_cache, user_cache
from .console import note
from .errors import InputError

LIBRARY = Path(__file__).resolve().parents[1]
PACKAGE_CACHE = LIBRARY / "__pycache__" / "kernels"
SUFFIX = ".kernel"
PROBE_BYTES = 1 << 18  # size of the test file of `_usable`; the largest compiled kernels have 0.2 MB
CHECKSUM = hashlib.sha256
CHECKSUM_BYTES = CHECKSUM().digest_size


def compiled(**options) -> Callable[[Callable], Callable]:
    """Decorate a function so that numba (`njit(**options)`) compiles it when it is called and its machine code is kept.

    Raises
    ------
    InputError
        If NUMBA_DISABLE_JIT is set.
    """
    if numba.config.DISABLE_JIT:
        raise InputError("NUMBA_DISABLE_JIT: Numba's compiler is off, and kernels run only compiled; unset it")

    def decorate(function: Callable) -> Callable:
        dispatcher = numba.njit(**options)(function)
        if not isinstance(getattr(dispatcher, "_cache", None), NullCache):
            raise ImportError(f"numba {numba.__version__} has another interface for caches; install numba 0.68")
        dispatcher._cache = KernelCache(function)
        return dispatcher

    return decorate


@cache
def _source_hash(*files: str | Path) -> str:
    return hashlib.sha256(b"".join(Path(file).read_bytes() for file in files)).hexdigest()


class KernelCache(_Cache):
    """Cache in which a dispatcher looks up and stores the code of a signature."""

    def __init__(self, function: Callable):
        file = function.__code__.co_filename
        self._name = f"{Path(file).stem}.{function.__qualname__}"
        # Code of other modules may contain inlined functions of `projectors`.
        sources = (_source_hash(file), _source_hash(*sorted((LIBRARY / "projectors").glob("*.py"))))
        versions = (sys.implementation.cache_tag, numba.__version__, llvmlite.__version__)
        self._made_from = (self._name, sources, versions)

    @property
    def cache_path(self) -> str:
        """The first folder of the cache."""
        return str(next(_folders()))

    def load_overload(self, sig, target_context) -> CompileResult | None:
        """Return the code of a signature from disk; None if it must be compiled."""
        target_context.refresh()
        key = self._key(sig, target_context.codegen())
        for folder in _folders():
            if (payload := _read(folder / self._file_name(key), key)) is not None:
                found = CompileResult._rebuild(target_context, *pickle.loads(payload))
                if found.signature.args == normalize_signature(sig)[0]:
                    return found
        return None

    def save_overload(self, sig, data: CompileResult) -> None:
        """Write the code of a signature to the first writable folder."""
        if data.library.has_dynamic_globals:  # the code contains addresses of this process
            return
        key = self._key(sig, data.codegen)
        payload = dumps(data._reduce())
        content = CHECKSUM(key + payload).digest() + payload
        problems = {}
        for folder in _folders(for_writing=True):
            try:
                _write(folder / self._file_name(key), content)
            except OSError as error:
                problems[folder] = error.strerror or type(error).__name__
            else:
                break
        else:
            tried = ", ".join(f"{folder}: {reason}" for folder, reason in problems.items())
            _note_once(
                f"compiled kernels cannot be kept ({tried}), and each process compiles them again; set NUMBA_CACHE_DIR "
                "to a folder that can be written to"
            )
            return
        if (stated := _stated()) in problems:
            _note_once(
                f"NUMBA_CACHE_DIR: {stated} cannot be written to ({problems[stated]}); compiled kernels are kept in "
                f"{folder}"
            )

    def enable(self) -> None:
        """Do nothing: the cache is always enabled."""

    def disable(self) -> None:
        """Do nothing: the cache is always enabled."""

    def flush(self) -> None:
        """Do nothing: code that is compiled again replaces its file."""

    def _key(self, sig, codegen) -> bytes:
        arguments, _ = normalize_signature(sig)
        return repr((self._made_from, arguments, codegen.magic_tuple())).encode()

    def _file_name(self, key: bytes) -> str:
        return f"{self._name}-{hashlib.sha256(key).hexdigest()[:32]}{SUFFIX}"


def _stated() -> Path | None:
    """Return the folder in NUMBA_CACHE_DIR; None if it is not set."""
    return Path(os.path.expanduser(numba.config.CACHE_DIR)).absolute() if numba.config.CACHE_DIR else None


def _folders(for_writing: bool = False) -> Iterator[Path]:
    """Yield folders for compiled code in the order in which they are tried.

    NUMBA_CACHE_DIR is first if it is set, and the only folder that is read if it can be used. The package folder
    follows (code of a container image or of an installation), then the user's cache and temporary files.
    """
    if (stated := _stated()) is not None:
        yield stated
        if not for_writing and _usable(stated):
            return
    yield PACKAGE_CACHE
    if (user := user_cache()) is not None:
        yield user / "kernels"
    if (temporary := temporary_cache(make=for_writing)) is not None:
        yield temporary / "kernels"


@cache
def _usable(folder: Path) -> bool:
    """Return whether a kernel can be written to a folder, which is created if it is missing."""
    probe = folder / f"probe.tmp.{uuid.uuid4().hex}"
    try:
        _write(probe, bytes(PROBE_BYTES))
        probe.unlink()
    except OSError:
        return False
    return True


def _read(path: Path, key: bytes) -> bytes | None:
    """Return the content of a file; None if it is missing, damaged, or has another key."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    checksum, payload = content[:CHECKSUM_BYTES], content[CHECKSUM_BYTES:]
    return payload if checksum == CHECKSUM(key + payload).digest() else None


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically, so that no other process reads a part of it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path.parent)) from None
    partial = path.with_name(f"{path.name}.tmp.{uuid.uuid4().hex}")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


@cache
def _note_once(text: str) -> None:
    note(text)
