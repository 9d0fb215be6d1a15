"""Real processes with a sensor, an actuator and loads between them."""

import math

import numpy as np
import pytest
from sensor_msgs.msg import JointState
import yaml

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.parameter_file import read_experiment
from impulse_control_ros.files.recording import read
from impulse_control_ros.tools.rerun import with_velocities
from test.conftest import CONFIG
from test.nodes.runs import assert_simulated, assert_whole, three_processes

HARDWARE = {
    'stribeck': {'F_s': 1.2, 'v_s': 0.02},
    'sensor': {'resolution': 1e-4, 'position_noise': 1e-5, 'velocity': 'ideal',
               'velocity_noise': 1e-2, 'seed': 5},
    'actuator': {'limit': 900.0, 'time_constant': 3e-4, 'delay': 4},
    'payload': {'mass': 0.02, 'time': 0.05},
    'disturbance': {'kind': 'noise', 'force': 0.3, 'start': 0.01, 'end': 0.2, 'bandwidth': 20.0,
                    'seed': 2}}
OPTIONS = {'position_deadband': 2e-4, 'velocity_deadband': 0.12, 'lead': 0.5,
           'position_hysteresis': 1.5e-4, 'velocity_hysteresis': 0.02,
           'stick_samples': 6, 'K_i': 3.0}


@pytest.fixture
def experiment(graph):
    """Return a function that writes an experiment with other parameters of plant and law."""
    def written(name='encoder', controller=OPTIONS, **plant):
        content = yaml.safe_load((CONFIG / f'{name}.yaml').read_text())
        for node, values in (('plant_simulator', plant), ('controller', controller)):
            content[f'/**/{node}']['ros__parameters'] |= values
        path = graph.folder / 'experiment.yaml'
        path.write_text(yaml.safe_dump(content))
        return path
    return written


@pytest.mark.parametrize('velocity', ['ideal', 'difference', 'none'])
def test_with_all_hardware_the_composed_process_is_the_simulation_to_the_last_bit(
        graph, experiment, velocity):
    sensor = HARDWARE['sensor'] | {'velocity': velocity}
    config, bag = experiment(duration=0.5, **HARDWARE | {'sensor': sensor}), graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '-p', f'recorder:bag:={bag}',
                          config=config)
    assert process.wait() == 0, process.output
    assert_whole(read(bag))
    assert_simulated(read(bag), config)
    for how in ('--controller', '--closed-loop'):
        replayed = graph.start('replay', bag, how)
        assert replayed.wait() == 0, replayed.output
        assert 'every message is the same, to the bit' in replayed.output
    made = read_experiment(config)
    run = simulate(made.plant_simulator, made.controller, 0.5)
    velocity = with_velocities(read(bag))['velocity']
    assert np.array_equal(velocity[run.events['tick']], run.events['velocity'])
    assert np.isfinite(velocity).all()


def test_three_processes_settle_on_an_encoder_and_give_no_impulse_at_rest(graph):
    config = CONFIG / 'encoder.yaml'
    bag = graph.folder / 'bag'
    three_processes(graph, ('plant_simulator', 'controller', 'recorder'), config, bag)
    assert_simulated(read(bag), config)
    step = read_experiment(config).plant_simulator.sensor.resolution
    recording = read(bag)
    late = 2_000_000_000  # the second half of the run
    states = recording.states[recording.states['stamp'] >= late]
    assert np.abs(states['position']).max() <= 2 * step
    assert 5e-3 < np.std(states['velocity']) < 2e-2
    assert not (recording.impulses['stamp'] >= late).any()


def test_hardware_can_be_changed_in_mid_run_and_replayed_to_the_bit(graph, client, experiment):
    bag = graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '-p', f'recorder:bag:={bag}', '-p',
                          'plant_simulator:real_time_factor:=1.0', config=experiment(duration=0.0))
    process.says('running from')
    for change in ({'actuator.delay': 3}, {'sensor.velocity': 'difference'},
                   {'sensor.velocity': 'none'}, {'payload.mass': 0.01},
                   {'sensor.resolution': 1e-3, 'disturbance.force': 0.5}):
        assert client.set('plant_simulator', **change).successful
    assert client.set('controller', lead=0.5, stick_samples=9,
                      velocity_source='estimated').successful
    refused = client.set('plant_simulator', **{'payload.mass': -1.0})
    assert not refused.successful
    assert refused.reason == 'payload.mass = -1.0 is refused: allowed is > -m = -0.1 [kg]'
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: states, 'a state')
    assert process.interrupt() == 0, process.output
    assert len(states[-1].position) == 1
    assert len(states[-1].velocity) == 0
    replayed = graph.start('replay', bag, '--closed-loop')
    assert replayed.wait() == 0, replayed.output


def state(stamp, names, position, velocity=()):
    message = JointState(name=names, position=position, velocity=velocity)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message


def test_the_controller_finds_its_joint_among_several_with_or_without_velocities(graph, client):
    process = graph.start('controller', config=CONFIG / 'underdamped.yaml')
    commands = client.listen('/joint_commands', JointState)
    publisher = client.node.create_publisher(JointState, '/joint_states', 100)
    client.spin_until(lambda: publisher.get_subscription_count(), 'the controller')
    client.spin_until(lambda: client.node.count_publishers('/joint_commands'), 'its commands')

    def answer(*content):
        before = len(commands)
        publisher.publish(state(*content))
        client.spin_until(lambda: len(commands) > before, 'a command')
        return commands[-1].name, list(commands[-1].effort)
    names = ['knee', 'axis', 'elbow']
    # the first lies on the guard of the velocity zero: PD and an impulse of -0.375 N s
    first = answer(10**9, names, [9.0, 0.5, -9.0], [9.0, 0.0, -9.0])
    assert first == (['axis'], [-5.0 - 0.375 / 1e-4])
    assert answer(10**9 + 10**5, names, [9.0, 0.4, -9.0], [9.0, -2.0, -9.0]) == (
        ['axis'], [-4.0 + 1.0])
    assert answer(10**9 + 2 * 10**5, names, [9.0, 0.4, -9.0])[1][0] < -3.0
    assert answer(10**9 + 3 * 10**5, names[::-1], [9.0, 0.3, -9.0], [0.0, -1.0, 0.0]) == (
        ['axis'], [-3.0 + 0.5])
    publisher.publish(state(10**9 + 4 * 10**5, names, [9.0, 0.3, -9.0], [1.0]))
    process.says("rejected a state without velocity of joint 'axis'")
    assert client.set('controller', velocity_source='estimated').successful
    assert answer(10**9 + 6 * 10**5, ['axis'], [0.3], [math.nan])[0] == ['axis']
    assert process.interrupt() == 0
