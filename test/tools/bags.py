"""Bags of simulated runs, as the recorder writes them."""

from dataclasses import replace
import json

import numpy as np

from impulse_control_ros import __version__
from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.tick import stamp
from impulse_control_ros.files.bag import BagWriter, PACKAGE
from impulse_control_ros.files.cdr import encode_float64, JointStateLayout, RESET_MARK
from impulse_control_ros.files.experiment import read_experiment
from test.conftest import CONFIG
from test.files.test_bag import START, STEP, topic

STATE, MARKED = JointStateLayout('axis'), JointStateLayout('axis', RESET_MARK)
COMMAND = JointStateLayout('axis', '', ('effort',))
EVENTS = [JointStateLayout('axis', guard) for guard in GUARDS]


def experiment(name):
    return read_experiment(CONFIG / f'{name}.yaml')


def entries(run, first=0, reset=True):
    """Yield the messages of a run that begins at tick ``first``."""
    applied, varies = np.append(0.0, run.effort[:-1]), np.ptp(run.damping) > 0.0
    events = {int(event['tick']): event for event in run.events}
    for k in range(len(run.time)):
        sec, nanosec = at = stamp(first + k, START, STEP)
        ns = sec * 10**9 + nanosec
        state = MARKED if k == 0 and reset else STATE
        yield ns, 1, state.encode(*at, run.position[k], run.velocity[k], applied[k])
        if k in events:
            event = events[k]
            layout = EVENTS[event['guard']]
            yield ns, 2, layout.encode(*at, event['position'], event['velocity'], event['area'])
        yield ns, 3, COMMAND.encode(*at, run.effort[k])
        if varies and k % 10 == 0 and k:
            yield ns, 4, encode_float64(run.damping[k - 1])


def begun(folder, made, compression='zstd'):
    """Return the writer of a bag of an experiment, with the parameters of its nodes."""
    writer = BagWriter(folder, compression)
    for name in ('/joint_states', '/impulse_events', '/joint_commands'):
        writer.add_topic(topic(name))
    writer.add_topic(topic('/damping', 'std_msgs/msg/Float64'))
    writer.add_metadata(PACKAGE, {
        'version': __version__, 'joint_states': '/joint_states',
        'impulse_events': '/impulse_events', 'joint_commands': '/joint_commands'})
    for node in ('plant_simulator', 'controller'):
        writer.add_metadata(f'parameters:/{node}', {
            name: json.dumps(value) for name, value in getattr(made, node).flat().items()})
    return writer


def finished(writer):
    writer.add_metadata('recording', {
        'messages': str(writer.count), 'missing': '0', 'repeated': '0', 'foreign': '0',
        'wall_seconds': '1.000000'})
    writer.close()
    return writer.folder


def recorded(folder, name, duration=2.0, axis=None, **gains):
    """Simulate an experiment with other gains into a bag; returns (bag, run)."""
    made = experiment(name)
    made = replace(made, controller=replace(made.controller, **gains),
                   plant_simulator=replace(made.plant_simulator, **(axis or {})))
    run = simulate(made.plant_simulator, made.controller, duration)
    writer = begun(folder, made)
    writer.write(entries(run))
    return finished(writer), run
