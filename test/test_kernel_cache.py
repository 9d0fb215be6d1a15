"""numba's cache may be missing, damaged, full or not writable: kernels run all the same."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import importlib.util
import logging
import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile

import pytest

from impulse_control_ros import kernel_cache
from impulse_control_ros.kernel_cache import KernelCache
from test.conftest import ROOT

SOURCE = """
from impulse_control_ros.core.jit import kernel

@kernel()
def twice(value):
    return 2.0 * value
"""
CLOSED_LOOP = """
import impulse_control_ros as ic
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.core.simulated_plant import SimulatedPlant

plant = ic.Plant(F_c=1.0, sensor=ic.Sensor(position_noise=1e-5), damping=ic.Damping(kind='noise'))
run = ic.simulate(plant, ic.ControlGains(), duration=0.05)
controller, simulated = SampledController(ic.ControlGains()), SimulatedPlant(plant)
simulated.step(controller.answer(0.5, 0.0)[0])
exact = ic.solve(ic.Plant(), ic.ControlGains(), duration=1.0)
print(run.position[-1].hex(), simulated.state()[1].hex(), exact.position[-1].hex())
"""


@pytest.fixture
def warned(caplog, monkeypatch) -> Callable[[], list[str]]:
    """Return what tells the warnings so far; the process has given none yet."""
    monkeypatch.setattr(KernelCache, '_warned', False)
    return lambda: [one.getMessage() for one in caplog.records if one.levelname == 'WARNING']


@pytest.fixture
def no_home(monkeypatch) -> None:
    """Have no folder of the user to write."""
    monkeypatch.setenv('XDG_CACHE_HOME', '/proc/none')


def started(folder: Path):
    """Return the kernel as a program that is started has it."""
    folder.mkdir(exist_ok=True)
    source = folder / 'module.py'
    source.write_text(SOURCE)
    spec = importlib.util.spec_from_file_location('module', source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.twice


def refuse(**_: object) -> None:
    raise PermissionError('read-only')


def files_of(folder: Path) -> list[Path]:
    return sorted((folder / '__pycache__').glob('*.nb?'))


@contextmanager
def disk_full() -> Iterator[None]:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_second_start_takes_the_machine_code_of_the_first_one(tmp_path, warned):
    for hits in (0, 1):
        kernel = started(tmp_path)
        assert kernel(21.0) == 42.0
        assert sum(kernel.stats.cache_hits.values()) == hits
    assert len(files_of(tmp_path)) == 1
    assert warned() == []


@pytest.mark.parametrize(
    'damaged',
    [
        pytest.param(lambda content: b'', id='empty'),
        pytest.param(lambda content: content[: len(content) // 2], id='cut off'),
        pytest.param(lambda content: bytes(len(content)), id='overwritten by zeros'),
        pytest.param(lambda content: b'not machine code', id='overwritten by text'),
        pytest.param(lambda content: content[:-9] + b'?' + content[-8:], id='one byte'),
    ],
)
def test_a_damaged_file_is_compiled_again_with_one_warning(tmp_path, warned, damaged):
    assert started(tmp_path)(21.0) == 42.0
    (file,) = files_of(tmp_path)
    file.write_bytes(damaged(file.read_bytes()))
    for _ in range(2):
        assert started(tmp_path)(21.0) == 42.0
    (warning,) = warned()
    assert 'is damaged' in warning
    assert 'set NUMBA_CACHE_DIR' in warning


def test_a_full_disk_leaves_the_kernels_in_memory_with_one_warning(tmp_path, warned):
    kernels = [started(tmp_path / name) for name in 'ab']
    with disk_full():
        results = [kernel(21.0) for kernel in kernels]
    assert results == [42.0, 42.0]
    (warning,) = warned()
    assert 'File too large' in warning
    assert files_of(tmp_path / 'a') == []


def test_without_any_folder_to_write_kernels_are_compiled_in_memory(tmp_path, warned, no_home):
    (tmp_path / '__pycache__').write_text('no folder')
    for _ in range(2):
        assert started(tmp_path)(21.0) == 42.0
    (warning,) = warned()
    assert 'set NUMBA_CACHE_DIR to a folder that can be written' in warning


def test_a_full_cache_that_cannot_be_written_is_used_without_a_word(
    tmp_path, warned, no_home, monkeypatch
):
    assert started(tmp_path)(21.0) == 42.0
    monkeypatch.setattr(tempfile, 'TemporaryFile', refuse)  # so numba tries whether it may write
    kernel = started(tmp_path)
    assert kernel(21.0) == 42.0
    assert sum(kernel.stats.cache_hits.values()) == 1
    assert warned() == []


def test_machine_code_of_other_sources_is_not_used(tmp_path, monkeypatch, warned):
    assert started(tmp_path)(21.0) == 42.0
    monkeypatch.setattr(kernel_cache, 'stamp', lambda: bytes(kernel_cache.CHECKSUM))
    for hits in (0, 1):
        kernel = started(tmp_path)
        assert kernel(21.0) == 42.0
        assert sum(kernel.stats.cache_hits.values()) == hits
    assert warned() == []


def test_long_compiling_is_told_once(tmp_path, caplog, monkeypatch):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(KernelCache, '_told', False)
    monkeypatch.setattr(kernel_cache, 'LONG', -1.0)
    for name in 'aba':
        started(tmp_path / name)(21.0)
    told = [one.getMessage() for one in caplog.records if 'compiling' in one.getMessage()]
    assert len(told) == 1


def test_without_compiling_the_bits_are_the_same():
    compiled, interpreted = (
        subprocess.run(
            [sys.executable, '-c', CLOSED_LOOP],
            check=True,
            capture_output=True,
            text=True,
            cwd=ROOT,
            env={**os.environ, 'NUMBA_DISABLE_JIT': disabled},
        ).stdout
        for disabled in '01'
    )
    assert interpreted == compiled
