"""How soon a run goes on after a kill, by the wall clock: medians, on an idle machine."""

from statistics import median
import time

import pytest

from test.nodes.long_run import SUBSCRIBER
from test.nodes.runs import composed, Run, start_as, STEP, UNDERDAMPED

pytestmark = pytest.mark.soak
ROUNDS = 10
COMMAND_TIMEOUT, RECORDER_TIMEOUT = 1.0, 1.0  # s


def told(what, seconds, bound):
    """Print the median of ``seconds``, and assert that it is within a bound."""
    found = median(seconds)
    print(
        f'SUMMARY {what}: median {found:.3f} s of {len(seconds)}, largest {max(seconds):.3f} s, '
        f'bound {bound:g} s'
    )
    assert found <= bound


def endpoints(client):
    """Return the publishers of commands that the client has discovered."""
    return {
        bytes(end.endpoint_gid)
        for end in client.node.get_publishers_info_by_topic('/joint_commands')
    }


def test_a_controller_started_anew_goes_on_soon_after_its_discovery(graph, client):
    run, seconds = Run(graph, client), []
    for _ in range(ROUNDS):
        before, known = run.active, endpoints(client)
        run.controller.kill()
        run.controller = run.start('controller')
        client.spin_until(lambda known=known: endpoints(client) - known, 'another controller')
        discovered = time.monotonic()
        run.answered_by('/controller', but=before)
        run.reach(10)
        seconds.append(time.monotonic() - discovered)
        run.reach(100)
    run.finish()
    told('goes on after the discovery of a new controller', seconds, COMMAND_TIMEOUT + 1.0)


def test_a_controller_that_stands_by_takes_over_soon(graph, client):
    run, seconds = Run(graph, client), []
    waiting = run.controller
    for number in range(ROUNDS):
        name, active = f'standby_{number}', waiting
        waiting = run.start('controller', name)
        client.spin_until(lambda name=name: client.count_of(name, 'standby'), 'who stands by')
        active.kill()
        killed = time.monotonic()
        run.answered_by(f'/{name}')
        seconds.append(time.monotonic() - killed)
        run.reach(100)
    run.controller = waiting
    run.finish()
    told('a controller takes over', seconds, COMMAND_TIMEOUT + 0.5)


def test_a_killed_recorder_is_released_soon(graph, client):
    run, seconds = (
        Run(
            graph,
            client,
            plant_simulator={'recorder_timeout': RECORDER_TIMEOUT, 'real_time_factor': 0.5},
        ),
        [],
    )
    for number in range(ROUNDS):
        run.reach(100)
        run.recorder.kill()
        killed, last = time.monotonic(), run.stamp
        client.spin_until(lambda last=last: run.stamp > last + 1200 * STEP, 'the release')
        seconds.append(time.monotonic() - killed)
        run.recorder = run.start('recorder', bag=graph.folder / f'bag_{number}')
        client.reported('plant_simulator', recorders=1)
    assert run.plant.interrupt() == run.recorder.interrupt() == run.controller.interrupt() == 0
    told('a killed recorder is released', seconds, RECORDER_TIMEOUT + 0.5)


def recorder(graph):
    return graph.start('recorder', config=UNDERDAMPED, bag=graph.folder / 'outside')


def controller(graph):
    return start_as(graph, 'other', 'controller')


def subscriber(graph):
    return graph.start('python', '-c', SUBSCRIBER)


@pytest.mark.parametrize(
    ('peer', 'name'),
    [(recorder, 'recorder'), (controller, 'other'), (subscriber, 'subscriber')],
    ids=['recorder', 'controller', 'subscriber'],
)
def test_a_composed_run_is_not_slowed_by_a_killed_peer(graph, client, peer, name):
    process = composed(
        graph,
        **{
            'plant_simulator:real_time_factor': 0.0,
            'plant_simulator:recorder_timeout': RECORDER_TIMEOUT,
        },
    )

    def speed(reports=3):
        """Return samples per second of wall time, over some reports of the plant."""
        client.spin_until(lambda: client.reports('plant_simulator'), 'a report')
        counts = []
        for _ in range(reports + 1):
            before = client.count_of('plant_simulator', 'steps')
            client.spin_until(
                lambda before=before: client.count_of('plant_simulator', 'steps') > before,
                'a report',
            )
            counts.append((time.monotonic(), client.count_of('plant_simulator', 'steps')))
        return (counts[-1][1] - counts[0][1]) / (counts[-1][0] - counts[0][0])

    other = peer(graph)
    if name == 'recorder':
        client.reported('plant_simulator', recorders=2)
    else:
        client.spin_until(lambda: name in client.nodes(), name)
    before = speed()
    other.kill()
    if name == 'recorder':
        client.reported('plant_simulator', recorders=1)
    after = speed()
    assert process.interrupt() == 0, process.output
    print(
        f'SUMMARY composed beside a killed {name}: {before:.0f} steps/s before, {after:.0f} '
        f'after: {after / before:.2f}'
    )
    assert after >= 0.8 * before
