"""Bags of simulated runs, as the recorder writes them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from impulse_control_ros import __version__
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.protocol import CommandHeader, NodeHeader, StateHeader
from impulse_control_ros.core.replay import run_again, spans
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.tick import stamp
from impulse_control_ros.files.bag import BagWriter, PACKAGE
from impulse_control_ros.files.cdr import encode_float64, FIELDS, JointStateLayout
from impulse_control_ros.files.parameter_event import encode_parameter_event, TYPE
from impulse_control_ros.files.parameter_file import load_experiment
from test.conftest import CONFIG
from test.files.test_bag import RUN, START, STEP, STORE, topic

PLANT, CONTROLLER = '/plant_simulator', '/controller#4567'
STATES, EVENTS, COMMANDS, PARAMETERS, DAMPING = range(1, 6)
WALL = 1_790_000_000 * 10**9
TOPICS = {
    STATES: '/joint_states',
    EVENTS: '/impulse_events',
    COMMANDS: '/joint_commands',
    PARAMETERS: '/run_parameters',
    DAMPING: '/damping',
}
TYPES = dict.fromkeys(TOPICS, 'sensor_msgs/msg/JointState') | {
    PARAMETERS: TYPE,
    DAMPING: 'std_msgs/msg/Float64',
}


def experiment(name):
    return load_experiment(CONFIG / f'{name}.yaml')


def state_layout(run, episode=0, controller='', fields=FIELDS):
    return JointStateLayout('axis', StateHeader(run, episode, controller).frame_id, fields)


def command_layouts(run, episode, author, fields):
    """Return a layout by guard and verdict."""
    return {
        (guard, verdict): JointStateLayout(
            'axis',
            CommandHeader(run, episode, author, GUARDS[guard], VERDICTS[verdict]).frame_id,
            fields,
        )
        for guard in range(len(GUARDS))
        for verdict in range(len(VERDICTS))
    }


def told(node, values, changed=(), tick=0, run=RUN):
    """Return the message with which a node tells its parameters, of which some have changed."""
    at = stamp(tick, START, STEP)
    ns = at[0] * 10**9 + at[1]
    changed = {name: values[name] for name in changed}
    return (
        ns,
        PARAMETERS,
        encode_parameter_event(*at, NodeHeader(run, node).frame_id, values, changed),
    )


def all_told(made, run=RUN, tick=0):
    """Return the parameters of both nodes of an experiment, at the start of a run."""
    return [
        told(PLANT, made.plant.flat(), tick=tick, run=run),
        told(CONTROLLER, made.gains.flat(), tick=tick, run=run),
    ]


def entries(simulated, first=0, run=RUN, episode=0, author=CONTROLLER, named=None, applied=0.0):
    """
    Yield the messages of a simulated run that begins at tick ``first``.

    The states name the ``author`` of the commands; the first one names ``named``, by default
    nobody where it is the first of a run, and tells the effort ``applied`` before it.
    """
    named = named if named is not None else '' if not first else author
    varies = np.ptp(simulated.damping) > 0.0
    applied = np.append(applied, simulated.effort[:-1])
    fired = {int(event['tick']): event for event in simulated.events}
    judged = {int(one['tick']): one for one in simulated.verdicts}
    states = [state_layout(run, episode, one) for one in (named, author)]
    events, commands = (
        command_layouts(run, episode, author, fields) for fields in (FIELDS, ('effort',))
    )
    for k in range(len(simulated.time)):
        sec, nanosec = at = stamp(first + k, START, STEP)
        ns, event, verdict = sec * 10**9 + nanosec, fired.get(k), judged.get(k)
        what = (
            0 if event is None else int(event['guard']),
            0 if verdict is None else int(verdict['verdict']),
        )
        yield (
            ns,
            STATES,
            states[k > 0].encode(*at, simulated.position[k], simulated.velocity[k], applied[k]),
        )
        if any(what):
            at_event, area = (verdict, 0.0) if event is None else (event, event['area'])
            values = at_event['position'], at_event['velocity'], area
            yield ns, EVENTS, events[what].encode(*at, *values)
        yield ns, COMMANDS, commands[what].encode(*at, simulated.effort[k])
        if varies and k % 10 == 0 and k:
            yield ns, DAMPING, encode_float64(simulated.damping[k - 1])


def event_count(simulated):
    """Return the number of events: samples with an impulse or a verdict."""
    return len({int(one['tick']) for one in (*simulated.events, *simulated.verdicts)})


def computed(pieces, count):
    """Yield (first tick, simulated run, effort applied before) of each piece of a run."""
    states, answers = run_again(count, pieces)
    for _, span in spans(pieces, count):
        answer, state = answers[span], states[span]
        events = [
            {
                'tick': k,
                'guard': answer['guard'][k],
                'area': answer['area'][k],
                'position': state['position'][k],
                'velocity': answer['velocity'][k],
            }
            for k in np.flatnonzero(answer['guard'])
        ]
        yield (
            span.start,
            SimpleNamespace(
                time=np.arange(len(state)),
                position=state['position'],
                velocity=state['velocity'],
                effort=answer['effort'],
                damping=state['damping'][1:],
                events=events,
                verdicts=[
                    {
                        'tick': k,
                        'verdict': answer['verdict'][k],
                        'position': state['position'][k],
                        'velocity': answer['velocity'][k],
                    }
                    for k in np.flatnonzero(answer['verdict'])
                ],
            ),
            (state['effort'][0]),
        )


def recorded_elsewhere(folder, messages):
    """Return a bag as ``ros2 bag record`` makes it of (wall time [ns], topic, type, message)."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for time, name, kind, raw in messages:
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=STORE)
            writer.write(connections[name], time, raw)
    return folder


def sent(messages, start=WALL, every=1000, namespace=''):
    """Yield messages as sent one after the other from a time of the wall clock on."""
    for at, (_, number, raw) in enumerate(messages):
        yield start + every * at, namespace + TOPICS[number], TYPES[number], raw


def begun(folder, made, compression='zstd', run=RUN, told_by=None):
    """Return the writer of a bag of an experiment, with the parameters of its nodes."""
    writer = BagWriter(folder, compression)
    for number, name in TOPICS.items():
        writer.add_topic(topic(name, TYPES[number]))
    writer.add_metadata(
        PACKAGE,
        {
            'version': __version__,
            'run': run,
            **{name.strip('/'): name for number, name in TOPICS.items() if number != DAMPING},
        },
    )
    writer.write(all_told(made, run) if told_by is None else told_by)
    return writer


def finished(writer):
    writer.add_metadata(
        'recording',
        {
            'messages': str(writer.count),
            'missing': '0',
            'repeated': '0',
            'foreign': '0',
            'wall_seconds': '1.000000',
        },
    )
    writer.close()
    return writer.folder


def recorded(folder, name, duration=2.0, axis=None, **gains):
    """Simulate an experiment with other gains into a bag; returns (bag, run)."""
    made = experiment(name)
    made = replace(
        made,
        gains=replace(made.gains, **gains),
        plant=replace(made.plant, **(axis or {})),
    )
    run = simulate(made.plant, made.gains, duration)
    writer = begun(folder, made)
    writer.write(entries(run))
    return finished(writer), run
