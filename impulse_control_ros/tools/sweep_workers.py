"""
Where the chunks of a sweep are computed: threads here, or the workers of a Dask cluster.

Both are executors of concurrent.futures and one loop serves them. A chunk is a task of one
thread, as the kernels release the GIL; a worker of n threads computes n chunks.
"""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    CancelledError,
    Executor,
    FIRST_COMPLETED,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
import logging
import sys
from time import monotonic
from typing import Any

import numba
import numpy as np
from tqdm import tqdm

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.core.sweep_config import run_chunk, SweepConfig
from impulse_control_ros.errors import SweepError
from impulse_control_ros.files.sweep_config_file import code_digest

IDLE = 0.1  # s between looks at the stop request
CONNECT = 5  # s
RETRIES = 3
Columns = dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Workers:
    """An ``executor``, how many tasks it does at once now, and its name."""

    executor: Executor
    slots: Callable[[], int]
    name: str


def verified_chunk(study: SweepConfig, number: int, code: str) -> Columns:
    """Run a chunk, if the code here is that of the sweep."""
    if code_digest() != code:
        raise SweepError('a worker has another version of impulse_control_ros')
    return run_chunk(study, number)


@contextmanager
def local_workers() -> Iterator[Workers]:
    """Yield a thread for each core that numba may use."""
    cores = int(numba.config.NUMBA_NUM_THREADS)
    with ThreadPoolExecutor(cores) as executor:
        try:
            yield Workers(executor=executor, slots=lambda: cores, name=f'{cores} cores')
        finally:
            executor.shutdown(cancel_futures=True)


@contextmanager
def dask_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of an existing cluster; raise `SweepError` where there is none."""
    logging.disable()  # what the library says on many lines we say on one
    client = connected(address)
    try:
        yield Workers(
            executor=client.get_executor(pure=False, retries=RETRIES),
            slots=lambda: sum(client.nthreads().values()),
            name=address,
        )
    except (OSError, CancelledError) as error:
        if not isinstance(error, CancelledError) and client.status == 'running':
            raise  # ours, as of a disk that is full
        raise SweepError(
            f'the scheduler at {address} has gone; the same command goes on from there'
        ) from None
    finally:
        client.close(timeout=1)


def connected(address: str) -> Any:
    """Return a client of the scheduler at ``address``; raise `SweepError` where there is none."""
    try:
        from distributed import Client
        from distributed.comm import connect
        from distributed.security import Security
    except ModuleNotFoundError:
        raise SweepError(
            "--scheduler needs dask.distributed: pip install 'impulse_control_ros"
            "[dask]', or pip install distributed"
        ) from None

    async def probe() -> None:
        await (
            await connect(address, timeout=CONNECT, **Security().get_connection_args('client'))
        ).close()

    try:
        asyncio.run(probe())  # a Client that finds nobody takes long to give up, and says more
        return Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SweepError(
            f'no scheduler answers at {address}: {" ".join(str(error).split())}'
        ) from None


def computed(
    workers: Workers, study: SweepConfig, todo: Sequence[int], stop: StopRequest
) -> Iterator[tuple[int, Columns]]:
    """
    Yield (number, columns) of the chunks ``todo`` as they are finished, until a stop.

    No more chunks are under way than keep the workers busy, so memory does not grow with their
    number. Raises `SweepError` for a chunk that fails on a cluster.
    """
    left, waiting = list(reversed(todo)), dict[Future[Columns], int]()
    slots, looked = present(workers, 1), monotonic()
    while (left or waiting) and not stop.requested:
        if monotonic() > looked + 1.0:
            slots, looked = present(workers, slots), monotonic()
        while left and len(waiting) < 2 * max(slots, 1):
            number = left.pop()
            waiting[workers.executor.submit(verified_chunk, study, number, code_digest())] = number
        for future in wait(waiting, IDLE, FIRST_COMPLETED).done:
            yield waiting.pop(future), result_of(future)


def present(workers: Workers, before: int) -> int:
    """Return how many tasks are done at once now; say it when there is nobody any more."""
    slots = workers.slots()
    if before and not slots:
        tqdm.write(
            f'sweep: {workers.name} has no worker: waiting for one that has this version '
            'of impulse_control_ros',
            sys.stderr,
        )
    return slots


def result_of(future: Future[Columns]) -> Columns:
    """Return a chunk's columns; say in one line what went wrong on a worker."""
    try:
        return future.result()
    except Exception as error:
        is_foreign = type(error).__module__.split('.')[0] == 'distributed'
        if not is_foreign and not isinstance(error, ModuleNotFoundError):
            raise
        raise SweepError(f'the cluster fails: {" ".join(str(error).split())}') from None
