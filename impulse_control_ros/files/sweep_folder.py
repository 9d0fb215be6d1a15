"""
The folder of a sweep.

    FOLDER/parts/part_0000012.parquet   chunk 12, while the sweep is not finished
    FOLDER/runs.parquet                 all runs, in order; then there are no parts

Each file carries the identity of its study and appears only when complete, so an interrupted sweep
continues from the chunks that exist. A part that cannot be read completely, checksums included, is
computed again.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import fcntl
import os
from pathlib import Path
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from impulse_control_ros.errors import ParameterError, SweepError
from impulse_control_ros.files.atomic_write import replaced
from impulse_control_ros.files.sweep_config_file import difference

KEY = b'impulse_control_ros'
ROW_GROUP = 32_768
OPTIONS = {'compression': 'zstd', 'use_dictionary': False, 'write_page_checksum': True}
UNREADABLE = (pa.ArrowException, OSError, ValueError)


class SweepFolder:
    """
    The results of one study, by its ``identity``.

    ``units`` has the unit of each column, in column order.
    """

    def __init__(self, path: Path, identity: str, units: Mapping[str, str]) -> None:
        self.path, self._identity, self._units = path, identity, units
        self.result, self._parts = path / 'runs.parquet', path / 'parts'

    def is_concluded(self) -> bool:
        """Return whether the result exists; refuse the folder of another study."""
        if self.path.exists() and not self.path.is_dir():
            raise ParameterError(f'{self.path}: must be a folder')
        if not self.result.exists():
            return False
        try:
            self._require_identity(schema_of(self.result))
        except UNREADABLE as error:
            # an OSError with a number is the reason itself, as a permission that is missing
            if isinstance(error, ParameterError) or getattr(error, 'errno', None):
                raise
            raise ParameterError(
                f'{self.result} is not the result of a sweep: choose another --out or move it away'
            ) from None
        return True

    @contextmanager
    def held(self) -> Iterator[None]:
        """Lock the folder against other sweeps; remove it if it stays empty."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ParameterError(f'--out {self.path}: {error.strerror}') from None
        handle = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise SweepError(f'another sweep is working in {self.path}') from None
        try:
            yield
        finally:
            if not any(self.path.iterdir()):
                self.path.rmdir()
            os.close(handle)

    def finished(self) -> set[int]:
        """Return the numbers of the finished chunks; refuse parts of another study."""
        found = set()
        for path in self._parts.glob('part_*.parquet'):
            try:
                self._require_identity(schema_of(path))
                read_part(path)
                found.add(int(path.stem.removeprefix('part_')))
            except ParameterError:
                raise
            except UNREADABLE:
                continue
        return found

    def save(self, number: int, columns: Mapping[str, np.ndarray]) -> None:
        """Save a chunk."""
        table = pa.table({name: pa.array(columns[name]) for name in self._units})
        fields = [field.with_metadata({'unit': self._units[field.name]}) for field in table.schema]
        table = table.cast(pa.schema(fields, {KEY: self._identity}))
        self._parts.mkdir(exist_ok=True)
        with replaced(self._part(number)) as path, path.open('wb') as stream:
            pq.write_table(table, stream, **OPTIONS)

    def conclude(self, chunks: int) -> None:
        """Join all parts into the result, some rows at a time, and remove the parts."""
        schema = schema_of(self._part(0))
        with (
            replaced(self.result) as path,
            path.open('wb') as stream,
            pq.ParquetWriter(stream, schema, **OPTIONS) as writer,
        ):
            waiting: list[pa.Table] = []
            for number in range(chunks):
                waiting.append(read_part(self._part(number)))
                if sum(map(len, waiting)) >= ROW_GROUP or number + 1 == chunks:
                    writer.write_table(pa.concat_tables(waiting).combine_chunks())
                    waiting.clear()
        self.remove_parts()

    def remove_parts(self) -> None:
        """Remove the parts, which are superfluous once there is a result."""
        shutil.rmtree(self._parts, ignore_errors=True)

    def column(self, name: str) -> np.ndarray:
        """Return a column of the result; raises `SweepError` if it is damaged."""
        try:
            with self.result.open('rb') as stream:
                return np.asarray(
                    pq.read_table(
                        stream,
                        columns=[name],
                        use_threads=False,
                        pre_buffer=False,
                        page_checksum_verification=True,
                    )[name]
                )
        except UNREADABLE as error:
            raise SweepError(f'{self.result}: {" ".join(str(error).split())}') from None

    def _part(self, number: int) -> Path:
        return self._parts / f'part_{number:07}.parquet'

    def _require_identity(self, schema: pa.Schema) -> None:
        there = (schema.metadata or {}).get(KEY)
        if there is None:
            raise ValueError('no sweep made this')
        if there.decode() != self._identity:
            raise ParameterError(
                f'{self.path} holds another study ({difference(there.decode(), self._identity)})'
                ': choose another --out or move it away'
            )


def read_part(path: Path) -> pa.Table:
    """Return a part after verifying its checksums."""
    with (
        path.open('rb') as stream,
        pq.ParquetFile(stream, page_checksum_verification=True) as part,
    ):
        return part.read(use_threads=False)


def schema_of(path: Path) -> pa.Schema:
    """Return the schema of a Parquet file."""
    with path.open('rb') as stream:
        return pq.read_schema(stream)
