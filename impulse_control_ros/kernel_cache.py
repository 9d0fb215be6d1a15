"""
numba's disk cache of compiled kernels, which never stops a program.

Where numba finds no folder to write, or a file that is damaged, it raises an exception; where a
file of another kernel was written last, it runs that one's code. Here each signature of a kernel
has its own file with a checksum, and what cannot be used is compiled in memory, with one warning.
"""

from collections.abc import Callable
from functools import cache
from hashlib import sha256
import logging
import math
from pathlib import Path
import pickle
from time import monotonic
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

CHECKSUM = sha256().digest_size
LONG = 1.0  # s of compiling before it is said

logger = logging.getLogger(__name__)


class ReadOnlyFolder:
    """The ``__pycache__`` of a kernel's file: numba's last choice, which may hold its code."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._folder = str(Path(file).parent / '__pycache__')
        self._line = function.__code__.co_firstlineno

    from_function = classmethod(lambda cls, function, file: cls(function, file))

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._folder

    def get_source_stamp(self) -> str:
        """Return nothing: `KernelFiles` has a stamp of all kernels."""
        return ''

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name apart."""
        return str(self._line)

    def ensure_cache_path(self) -> None:
        """Do nothing: a write will raise `OSError`."""


class Folders(CompileResultCacheImpl):
    """The folders of numba, in its order, and then the read-only one."""

    _locator_classes = [*CompileResultCacheImpl._locator_classes, ReadOnlyFolder]


class KernelFiles(IndexDataCacheFile):
    """The files of a kernel: checksum, stamp of all that was compiled, key and machine code."""

    def load(self, key: Any) -> Any:
        """Return the code of ``key``, None for none; raises `ValueError` for a damaged file."""
        path = self._path(key)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        rest = content[CHECKSUM:]
        if sha256(rest).digest() != content[:CHECKSUM]:
            raise ValueError(f'{path.name} is damaged')
        if rest[:CHECKSUM] != stamp():
            return None
        of_key, data = pickle.loads(rest[CHECKSUM:])  # noqa: S301 (as numba does)
        return data if of_key == key else None

    def save(self, key: Any, data: Any) -> None:
        """Write the code of ``key``; raises `OSError`."""
        rest = stamp() + self._dump((key, data))
        with self._open_for_write(str(self._path(key))) as file:
            file.write(sha256(rest).digest() + rest)

    def _path(self, key: Any) -> Path:
        number = int.from_bytes(sha256(repr(key[:2]).encode()).digest()[:6], 'big')
        return Path(self._data_path(self._data_name(number)))


class KernelCache(FunctionCache):
    """The disk cache of a kernel; its failure and long compiling are logged, each once."""

    _impl_class = Folders
    _began, _told, _warned = math.inf, False, False  # of the process

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = KernelFiles(self._cache_path, self._impl.filename_base, '')

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel, None where it is to be compiled."""
        try:
            found = super().load_overload(sig, target_context)
        except Exception as error:  # unpickling calls numba, llvmlite and numpy
            found = None
            self._warn(error)
        if found is None:
            self._tell_compiling()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel, if that is possible."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            self._warn(error)

    def _tell_compiling(self) -> None:
        KernelCache._began = min(KernelCache._began, monotonic())
        if not KernelCache._told and monotonic() > KernelCache._began + LONG:
            KernelCache._told = True
            logger.info('compiling for this machine, as a first start does; it takes seconds')

    def _warn(self, error: Exception) -> None:
        if not KernelCache._warned:
            KernelCache._warned = True
            logger.warning(
                f"numba's cache in {self._cache_path} cannot be used ({error}): compiling in "
                'memory; set NUMBA_CACHE_DIR to a folder that can be written'
            )


@cache
def stamp() -> bytes:
    """Return a digest of numba's version and of all kernels: one is compiled into another."""
    digest = sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob('core/*.py')):
        digest.update(path.read_bytes())
    return digest.digest()
