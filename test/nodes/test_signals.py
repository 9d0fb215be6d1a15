"""Ctrl-C and its like, at any time and any number of times."""

import itertools
import signal
import time

from test.nodes.runs import NODES
from test.processes import wait_for

EXECUTABLES = (*NODES, 'closed_loop')


def test_a_signal_during_the_imports_ends_a_node_without_a_traceback(graph):
    waiting = [graph.start(name) for name in EXECUTABLES]

    def all_imported():  # numba, which takes the longest
        for process in [one for one in waiting if 'llvmlite' in one.memory_map]:
            process.send(signal.SIGINT)
            waiting.remove(process)
        return not waiting

    started = list(waiting)
    wait_for(all_imported, 'numba')
    for process in started:
        assert process.wait() == 0, process.output
        assert 'Traceback' not in process.output


def test_a_node_that_waits_ends_at_a_storm_of_signals(graph, client):
    started = []
    for name in EXECUTABLES:
        arguments = ('--no-recorder',) if name == 'closed_loop' else ()
        started.append(graph.start(name, *arguments, '--ros-args', '-r', f'__ns:=/{name}'))
    for name, process in zip(EXECUTABLES, started, strict=True):
        node = 'controller' if name == 'closed_loop' else name
        client.get(f'{name}/{node}', 'use_sim_time')
        signals = itertools.cycle((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
        wait_for(
            lambda process=process: not process.running,
            f'the end of {name}',
            lambda process=process, signals=signals: (
                process.send(next(signals)),
                time.sleep(0.005),
            ),
        )
        assert process.wait() == 0, process.output
        assert 'Traceback' not in process.output
