"""What the controller tells of the supervision of its impulses."""

import pytest
from std_srvs.srv import Trigger

from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import assert_replays, composed
from test.processes import CONFIG

SUSPENDED = 'impulses suspended for {} s: jumps are 2.1 times what m = 0.1 kg gives; '
FAST = {'plant_simulator:real_time_factor': 0.5}
FITS = '0.048 kg would fit'


def warnings_of(process):
    return [line for line in process.output.splitlines() if '[controller]: impulse' in line]


def test_impulses_that_do_not_fit_are_told_once_and_suspended_and_resumed(graph):
    process = composed(
        graph,
        **{
            'plant_simulator:real_time_factor': 0.0,
            'plant_simulator:duration': 1.5,
            'plant_simulator:m': 0.048,
            'controller:learn_mass': False,
        },
    )
    assert process.wait() == 0, process.output
    said = [line.partition('[controller]: ')[2] for line in warnings_of(process)]
    strike = f'impulse out of band: jumps are 2.1 times what m = 0.1 kg gives; {FITS}'
    assert said == [
        strike,
        SUSPENDED.format(1) + FITS,
        'impulses resumed',
        strike,
        SUSPENDED.format(2) + FITS,
    ]
    assert_replays(graph.folder / 'bag')
    verdicts = read_bag(graph.folder / 'bag').verdicts['verdict']
    assert {VERDICTS[one] for one in verdicts} == {'out_of_band'}


def test_an_impulse_without_a_jump_is_told_with_the_timeout(graph):
    process = composed(
        graph,
        config=CONFIG / 'underdamped.yaml',
        **{
            'plant_simulator:real_time_factor': 0.0,
            'plant_simulator:duration': 0.5,
            'plant_simulator:actuator.delay': 1000,
            'controller:response_timeout': 100,
        },
    )
    assert process.wait() == 0, process.output
    (first, *_) = warnings_of(process)
    assert 'impulse absent: no jump was seen within response_timeout = 100 samples' in first


def test_the_learnt_mass_is_reported_and_kept_and_the_run_replays(graph, client):
    process = composed(graph, **FAST, **{'plant_simulator:m': 0.25})
    report = client.reported('controller', confirmed=11, last_verdict='confirmed', absent=0)
    assert float(report['learnt_mass']) == pytest.approx(0.25, rel=0.01)
    assert float(report['learnt_delay']) == float(report['suspended']) == 0.0
    kept = client.call('/controller/keep_learnt_mass', Trigger, once=True)
    assert (kept.success, kept.message) == (True, 'm: 0.25 kg, before 0.1 kg')
    assert client.get('controller', 'm') == [0.25]
    assert client.set('controller', x_r=0.2).successful
    client.spin_until(lambda: client.count_of('controller', 'impulses') > 15, 'impulses')
    assert process.interrupt() == 0, process.output
    bag = graph.folder / 'bag'
    assert_replays(bag)
    assert [change.changed for change in read_bag(bag).changes] == [{'m': 0.25}, {'x_r': 0.2}]


def test_supervision_can_be_set_while_the_controller_runs(graph, client):
    process = composed(graph, **FAST)
    client.reported('controller', confirmed=11)
    assert client.set('controller', supervision=False, x_r=0.2).successful
    client.spin_until(lambda: client.count_of('controller', 'impulses') > 15, 'impulses')
    count = client.reports('controller')['confirmed']
    limits = {'mass_ratio_limits.lower': 0.5, 'response_timeout': 200, 'learn_mass': False}
    assert client.set('controller', supervision=True, x_r=0.0, **limits).successful
    client.spin_until(
        lambda: client.count_of('controller', 'confirmed') > int(count) + 5, 'verdicts'
    )
    assert process.interrupt() == 0, process.output
    assert_replays(graph.folder / 'bag')


def test_no_mass_is_kept_before_one_is_learnt(graph, client):
    graph.start('controller')
    refused = client.call('/controller/keep_learnt_mass', Trigger)
    assert (refused.success, refused.message) == (False, 'no mass is learnt yet')
