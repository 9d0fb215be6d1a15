"""The access that security/ grants each node is the access that it takes, and no more."""

from importlib.util import find_spec
from xml.etree import ElementTree

import pytest
import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from test.conftest import ROOT

# the attribute in a policy, and how rclpy lists it
ACCESS = {'publish': 'publisher', 'subscribe': 'subscriber', 'reply': 'service',
          'request': 'client'}
OPTIONAL = [] if find_spec('simulation_interfaces') else [
    f'/plant_simulator/{name}' for name in (
        'get_simulation_state', 'get_simulator_features', 'reset_simulation',
        'set_simulation_state', 'step_simulation')]


def granted(name):
    """Return the access of a policy file: pairs of attribute and full name."""
    profile, = ElementTree.parse(ROOT / 'security' / f'{name}.policy.xml').iter('profile')
    assert (profile.get('ns'), profile.get('node')) == ('/', name)
    return {(access, f'/{name}{item.text[1:]}' if item.text.startswith('~')
             else f'/{item.text.lstrip("/")}')
            for group in profile for access in group.attrib for item in group}


def taken(node, name):
    """Return the access that a running node has now, as far as the graph tells."""
    try:
        return {(access, topic) for access, kind in ACCESS.items()
                for topic, _ in getattr(node, f'get_{kind}_names_and_types_by_node')(name, '/')}
    except rclpy.node.NodeNameNonExistentError:
        return set()


@pytest.fixture
def mute_plant(client):
    """A plant that never tells its parameters, so that who asks for them goes on asking."""
    node = rclpy.create_node('plant_simulator', context=client._context)
    yield node.create_publisher(JointState, 'joint_states', 10)
    node.destroy_node()


def show_a_state(client, mute_plant):
    """Publish a state once there is a controller."""
    client.spin_until(mute_plant.get_subscription_count, 'a controller')
    state = JointState(name=['axis'], position=[0.5], velocity=[0.0])
    state.header.stamp.sec = 1
    mute_plant.publish(state)


STANDING_BY = ('subscribe', '/joint_commands')


def assert_takes_what_is_granted(client, names):
    """Watch nodes until each has been seen with all that its policy grants, and nothing else."""
    wanted = {name: granted(name) - {('reply', optional) for optional in OPTIONAL}
              - ({STANDING_BY} if name == 'controller' else set()) for name in names}
    seen = {name: set() for name in names}

    def complete():
        for name, access in seen.items():
            access |= taken(client.node, name)
            assert not access - wanted[name]
        return seen == wanted
    try:
        client.spin_until(complete, 'the access that is granted')
    finally:
        print({name: wanted[name] - seen[name] for name in names})


def test_the_plant_takes_the_access_that_it_is_granted(graph, client):
    process = graph.start('plant_simulator', '--ros-args', '-p', 'damping.kind:=noise')
    assert_takes_what_is_granted(client, ['plant_simulator'])
    assert process.interrupt() == 0


def test_controller_and_recorder_take_the_access_that_they_are_granted(
        graph, client, mute_plant):
    processes = [
        graph.start('controller', '--ros-args', '-p', 'managed:=true'),
        graph.start('recorder', '--ros-args', '-p', f'bag:={graph.folder / "bag"}', '-p',
                    'topics:=[setpoint,damping,/parameter_events]')]
    for topic in ('/setpoint', '/damping'):
        client.node.create_publisher(Float64, topic, 10)
    client.activate()
    show_a_state(client, mute_plant)
    assert_takes_what_is_granted(client, ['controller', 'recorder'])
    for process in processes:
        assert process.interrupt() == 0


def test_a_controller_that_stands_by_takes_the_commands_that_it_is_granted(
        graph, client, mute_plant):
    client.node.create_publisher(JointState, '/joint_commands', 10)
    process = graph.start('controller')
    show_a_state(client, mute_plant)
    client.spin_until(lambda: STANDING_BY in taken(client.node, 'controller'), 'who stands by')
    assert STANDING_BY in granted('controller')
    process.says('/test_client is another controller of /joint_states: standing by')
    assert process.interrupt() == 0
