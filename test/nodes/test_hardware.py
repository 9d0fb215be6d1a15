"""Real processes with a sensor, an actuator and loads between them."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState
import yaml

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.tools.resimulate import with_velocities
from test.nodes.runs import assert_replays, assert_simulated, assert_whole, composed
from test.processes import CONFIG

HARDWARE = {
    'stribeck': {'F_s': 1.2, 'v_s': 0.02},
    'sensor': {
        'resolution': 1e-4,
        'position_noise': 1e-5,
        'velocity': 'ideal',
        'velocity_noise': 1e-2,
        'seed': 5,
    },
    'actuator': {'limit': 900.0, 'time_constant': 3e-4, 'delay': 4},
    'payload': {'mass': 0.02, 'time': 0.05},
    'disturbance': {
        'kind': 'noise',
        'force': 0.3,
        'start': 0.01,
        'end': 0.2,
        'bandwidth': 20.0,
        'seed': 2,
    },
}
OPTIONS = {
    'position_deadband': 2e-4,
    'velocity_deadband': 0.12,
    'guard_lookahead': 0.5,
    'position_hysteresis': 1.5e-4,
    'velocity_hysteresis': 0.02,
    'stiction_wait_samples': 6,
    'K_i': 3.0,
}
FAST = {'plant_simulator:real_time_factor': 0.0}


@pytest.fixture
def experiment(graph):
    """Return a function that writes an experiment with other parameters of the plant."""

    def written(**plant):
        content = yaml.safe_load((CONFIG / 'encoder.yaml').read_text())
        for node, values in (('plant_simulator', plant), ('controller', OPTIONS)):
            content[f'/**/{node}']['ros__parameters'] |= values
        path = graph.folder / 'experiment.yaml'
        path.write_text(yaml.safe_dump(content))
        return path

    return written


@pytest.mark.parametrize('velocity', ['ideal', 'difference', 'none'])
def test_with_all_hardware_the_composed_process_is_the_simulation_to_the_last_bit(
    graph, experiment, velocity
):
    sensor = HARDWARE['sensor'] | {'velocity': velocity}
    config, bag = experiment(**HARDWARE | {'sensor': sensor}), graph.folder / 'bag'
    process = composed(graph, config, **FAST, **{'plant_simulator:duration': 0.3})
    assert process.wait() == 0, process.output
    run = read_bag(bag)
    assert_whole(run)
    assert_simulated(run, config)
    for how in ('--controller', '--closed-loop'):
        assert_replays(bag, how)
    made = load_experiment(config)
    alone = simulate(made.plant, made.gains, 0.3)
    velocities = with_velocities(run)['velocity']
    assert np.isnan(run.states['velocity']).all() == (velocity == 'none')
    assert np.array_equal(velocities[alone.events['tick']], alone.events['velocity'])
    assert np.isfinite(velocities).all()


def test_an_axis_settles_on_an_encoder_and_gets_no_impulse_at_rest(graph):
    config = CONFIG / 'encoder.yaml'
    process = composed(graph, config, **FAST, **{'plant_simulator:duration': 2.0})
    assert process.wait() == 0, process.output
    run = read_bag(graph.folder / 'bag')
    assert_simulated(run, config)
    step = load_experiment(config).plant.sensor.resolution
    late = 2_000_000_000  # the second half of the run
    states = run.states[run.states['stamp'] >= late]
    assert np.abs(states['position']).max() <= 2 * step
    assert 5e-3 < np.std(states['velocity']) < 2e-2
    assert not (run.impulses['stamp'] >= late).any()


def test_hardware_can_be_changed_in_mid_run_and_replayed_to_the_bit(graph, client, experiment):
    process = composed(graph, experiment())
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: states, 'a state')
    for change in (
        {'actuator.delay': 3},
        {'sensor.velocity': 'difference'},
        {'sensor.velocity': 'none'},
        {'payload.mass': 0.01},
        {'sensor.resolution': 1e-3, 'disturbance.force': 0.5},
    ):
        assert client.set('plant_simulator', **change).successful
    assert client.set(
        'controller', guard_lookahead=0.5, stiction_wait_samples=9, velocity_source='estimated'
    ).successful
    refused = client.set('plant_simulator', **{'payload.mass': -1.0})
    assert not refused.successful
    assert 'payload.mass = -1.0' in refused.reason
    count = len(states)
    client.spin_until(lambda: len(states) > count + 20, 'states')
    assert process.interrupt() == 0, process.output
    assert len(states[-1].position) == 1
    assert len(states[-1].velocity) == 0
    assert_replays(graph.folder / 'bag')
