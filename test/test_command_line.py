"""What every executable does: exit statuses, one-line errors, Ctrl-C, and a closed pipe."""

import errno
import os
import subprocess
import sys

import pytest

from impulse_control_ros.command_line import exit_status
from impulse_control_ros.errors import (
    BagError,
    MissingPackageError,
    NodeError,
    RefusedError,
    SweepError,
    UsageError,
)
from test.conftest import BIN, CONFIG

EXECUTABLES = (
    *('plant_simulator', 'controller', 'recorder', 'closed_loop', 'excite'),
    *('simulate', 'analyze', 'identify', 'export_bag', 'replay', 'sweep', 'paper_figures'),
    'param',
)


@pytest.mark.parametrize(
    ('error', 'status', 'said'),
    [
        (UsageError('no BAG (see --help)'), 2, 'no BAG (see --help)'),
        (BagError('run: empty'), 2, 'run: empty'),
        (SweepError('interrupted'), 1, 'interrupted'),
        (NodeError('no node'), 1, 'no node'),
        (RefusedError('read-only'), 1, 'read-only'),
        (MissingPackageError('no plotly'), 1, 'no plotly'),
        (OSError(errno.ENOSPC, 'No space left', 'a.csv'), 1, 'a.csv: No space left'),
        (OSError(errno.EIO, 'I/O error'), 1, 'stdout: I/O error'),
    ],
)
def test_an_error_is_one_line_and_decides_the_exit_status(capsys, error, status, said):
    def fail():
        raise error

    assert exit_status('tool', fail) == status
    assert capsys.readouterr() == ('', f'tool: {said}\n')


def test_an_error_of_the_program_itself_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        exit_status('tool', lambda: 1 // 0)


@pytest.mark.parametrize('name', EXECUTABLES)
def test_an_unknown_option_is_refused_in_one_line(name):
    done = subprocess.run([BIN / name, '--nonsense'], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith(f'{name}: ')
    assert done.stderr.endswith(' (see --help)\n')
    assert done.stderr.count('\n') == 1


def simulated(folder, **streams):
    """Start ``simulate``, which prints one line."""
    arguments = [CONFIG / 'underdamped.yaml', folder / 'run', '-p', 'duration:=0.1']
    return subprocess.Popen(
        [BIN / 'simulate', *arguments], stderr=subprocess.PIPE, text=True, **streams
    )


def said(process):
    """Return what the process said, but for its first start on this machine."""
    return [line for line in process.stderr if ': compiling for this machine' not in line]


def test_a_closed_pipe_ends_a_command_without_a_word(tmp_path):
    with simulated(tmp_path, stdout=subprocess.PIPE) as process:
        process.stdout.close()
        assert said(process) == []
    assert process.returncode == 1


@pytest.mark.parametrize('name', EXECUTABLES)
def test_a_closed_pipe_ends_the_help_without_a_word(name):
    with subprocess.Popen(
        [BIN / name, '--help'],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {'PYTHONUNBUFFERED': ''},
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == ''
    assert process.returncode == 1


@pytest.mark.parametrize('closed', [1, 2])
def test_a_closed_stream_takes_what_is_printed(closed):
    done = subprocess.run(
        ['sh', '-c', f'{BIN}/analyze nowhere {closed}>&-'],
        capture_output=True,
        text=True,
        check=False,
    )
    said = '' if closed == 2 else "analyze: bag 'nowhere' does not exist\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, '', said)


@pytest.mark.parametrize('name', EXECUTABLES)
def test_a_deleted_folder_is_the_reason(tmp_path, name):
    (tmp_path / 'gone').mkdir()
    done = subprocess.run(
        ['sh', '-c', f'cd {tmp_path}/gone && rmdir {tmp_path}/gone && exec {BIN}/{name}'],
        capture_output=True,
        text=True,
        check=False,
    )
    why = 'the current folder was deleted: change to one that exists'
    assert (done.returncode, done.stdout, done.stderr) == (1, '', f'{name}: {why}\n')


def test_a_full_disk_behind_stdout_is_named(tmp_path):
    with open('/dev/full', 'w') as full, simulated(tmp_path, stdout=full) as process:
        assert said(process) == ['simulate: stdout: No space left on device\n']
    assert process.returncode == 1


@pytest.mark.parametrize(
    ('patience', 'expected'), [(0, 'interrupted'), (1, 'asked once'), (9, 'asked once')]
)
def test_more_interrupts_than_the_patience_end_a_process_at_once(patience, expected):
    code = f"""
import signal, sys
from impulse_control_ros.command_line import StopRequest
stop = StopRequest({patience})
signal.raise_signal(signal.SIGINT)
assert stop.requested
print('asked once', file=sys.stderr)
stop.ignore()
signal.raise_signal(signal.SIGTERM)
"""
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (int(patience == 0), f'{expected}\n')


@pytest.mark.parametrize(('before', 'expected'), [('SIG_DFL', 'True'), ('SIG_IGN', 'False')])
def test_a_hangup_is_a_request_to_stop_except_under_nohup(before, expected):
    code = f"""
import signal
from impulse_control_ros.command_line import StopRequest
signal.signal(signal.SIGHUP, signal.{before})
stop = StopRequest()
signal.raise_signal(signal.SIGHUP)
print(stop.requested)
"""
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout == f'{expected}\n'
