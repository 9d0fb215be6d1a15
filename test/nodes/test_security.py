"""The access that security/ grants each node is the access that it takes, and no more."""

from importlib.util import find_spec
from xml.etree import ElementTree

import rclpy
from std_msgs.msg import Float64

from test.nodes.runs import NODES as RUN
from test.processes import ROOT

NODES = ('dashboard', *RUN)  # it finds the others as they come
# the attribute in a policy, and how rclpy lists it
ACCESS = {
    'publish': 'publisher',
    'subscribe': 'subscriber',
    'reply': 'service',
    'request': 'client',
}
OPTIONAL = (
    set()
    if find_spec('simulation_interfaces')
    else {
        ('reply', f'/plant_simulator/{name}')
        for name in (
            'get_simulation_state',
            'get_simulator_features',
            'reset_simulation',
            'set_simulation_state',
            'step_simulation',
        )
    }
)


def granted(name):
    """Return the access of a policy file: pairs of attribute and full name."""
    (profile,) = ElementTree.parse(ROOT / 'security' / f'{name}.policy.xml').iter('profile')
    assert (profile.get('ns'), profile.get('node')) == ('/', name)
    return {
        (
            access,
            f'/{name}{item.text[1:]}'
            if item.text.startswith('~')
            else f'/{item.text.lstrip("/")}',
        )
        for group in profile
        for access in group.attrib
        for item in group
    }


def taken(node, name):
    """Return the access that a running node has now, as far as the graph tells."""
    try:
        return {
            (access, topic)
            for access, kind in ACCESS.items()
            for topic, _ in getattr(node, f'get_{kind}_names_and_types_by_node')(name, '/')
        }
    except rclpy.node.NodeNameNonExistentError:
        return set()


def test_each_node_takes_the_access_that_it_is_granted_and_no_more(graph, client):
    options = {
        'plant_simulator': {'damping.kind': 'noise', 'wait_for_recorder': True},
        'controller': {'lifecycle': True, 'command_interface': 'effort_array'},
        'recorder': {'bag': graph.folder / 'bag'},
    }
    dashboard = graph.start('dashboard', '--no-browser', '--port', 0)
    of_foreign_plants = ('subscribe', '/joint_states')  # until it finds one of ours
    client.spin_until(
        lambda: of_foreign_plants in taken(client.node, 'dashboard'), 'the dashboard'
    )
    processes = [dashboard, *(graph.start(name, **options[name]) for name in RUN)]
    client.node.create_publisher(Float64, '/setpoint', 10)
    client.activate()
    client.spin_until(lambda: client.count_of('plant_simulator', 'accepted'), 'a run')
    wanted = {name: granted(name) - OPTIONAL for name in NODES}
    seen = {name: set() for name in NODES} | {'dashboard': {of_foreign_plants}}

    def complete():
        for name, access in seen.items():
            access |= taken(client.node, name)
            assert access <= wanted[name]
        return seen == wanted

    try:
        client.spin_until(complete, 'the access that is granted')
    finally:
        print({name: wanted[name] - seen[name] for name in NODES})
    for process in processes[1:]:
        assert process.interrupt() == 0
    assert processes[0].interrupt() == 0


def test_excite_takes_the_access_that_it_is_granted_and_no_more(graph, client):
    controller = graph.start('controller')
    excite = graph.start('excite', '--travel', -1, 1, '--max-speed', 1, discovery_timeout=100.0)

    def complete():  # with no plant there are no states, and excite waits for them
        access = taken(client.node, 'excite')
        assert access <= granted('excite')
        return access == granted('excite')

    client.spin_until(complete, 'the access that is granted')
    assert excite.interrupt() == 1
    assert controller.interrupt() == 0
