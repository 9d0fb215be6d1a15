"""The services of simulation_interfaces, and a plant without that package."""

import os

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import assert_whole, composed, UNDERDAMPED

OURS = {
    'reset': 'std_srvs/srv/Trigger',
    'pause': 'std_srvs/srv/SetBool',
    'step': 'std_srvs/srv/Trigger',
}
STANDARD = {
    'GetSimulatorFeatures': 'get_simulator_features',
    'GetSimulationState': 'get_simulation_state',
    'SetSimulationState': 'set_simulation_state',
    'StepSimulation': 'step_simulation',
    'ResetSimulation': 'reset_simulation',
}
FROM_RCLPY = ('rcl_interfaces/', 'type_description_interfaces/')
PLANT = 'from impulse_control_ros.command_line import plant_simulator; sys.exit(plant_simulator())'


def start_plant(graph, **parameters):
    return graph.start(
        'plant_simulator', config=UNDERDAMPED, wait_for_recorder=False, **parameters
    )


def paused(graph, client):
    """Return a composed run that is paused somewhere in its middle."""
    process = composed(graph)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 20, 'states')
    assert client.call('/plant_simulator/pause', SetBool, data=True).success
    return process


def finish(client, process):
    """Let the run go on for a while and end it; returns the recording."""
    states = client.listen('/joint_states', JointState)
    client.call('/plant_simulator/pause', SetBool, data=False)
    client.spin_until(lambda: len(states) > 50, 'states')
    assert process.interrupt() == 0, process.output
    run = read_bag(process.folder / 'bag')
    assert_whole(run)
    return run


def offered(client, *least):
    """Return name and type of the plant's services, ``least`` and those that came with them."""
    client.reported('plant_simulator', steps=0)  # so it has made everything
    client.spin_until(lambda: 'plant_simulator' in client.nodes(), 'the plant')

    def listed():
        found = client.node.get_service_names_and_types_by_node('plant_simulator', '/')
        names = {name.rpartition('/')[2]: kinds[0] for name, kinds in found}
        own = {name: kind for name, kind in names.items() if not kind.startswith(FROM_RCLPY)}
        return own if own.keys() >= {*least} else None

    return client.spin_until(listed, f'services {least}')


class Standard:
    """The services as a client of the standard calls them."""

    def __init__(self, client):
        self._client = client
        self.msg = pytest.importorskip('simulation_interfaces.msg')
        self.srv = pytest.importorskip('simulation_interfaces.srv')
        self.states, self.results = self.msg.SimulationState, self.msg.Result

    def call(self, kind, once=False, **request):
        return self._client.call(
            f'/plant_simulator/{STANDARD[kind]}', getattr(self.srv, kind), once, **request
        )

    def set(self, state):
        return self.call('SetSimulationState', state=self.msg.SimulationState(state=state)).result

    def quit(self):
        """Ask for the end; the response may come too late to be awaited."""
        client = self._client.node.create_client(
            self.srv.SetSimulationState, '/plant_simulator/set_simulation_state'
        )
        self._client.spin_until(client.service_is_ready, 'the service')
        client.call_async(
            self.srv.SetSimulationState.Request(
                state=self.msg.SimulationState(state=self.states.STATE_QUITTING)
            )
        )

    @property
    def state(self):
        response = self.call('GetSimulationState')
        assert response.result.result == self.results.RESULT_OK
        return response.state.state


@pytest.fixture
def standard(client):
    return Standard(client)


def test_a_plant_lists_what_it_offers_and_offers_what_it_lists(graph, client, standard):
    start_plant(graph)
    features = standard.call('GetSimulatorFeatures').features
    ids = standard.msg.SimulatorFeatures
    assert set(features.features) == {
        ids.SIMULATION_RESET,
        ids.SIMULATION_RESET_STATE,
        ids.SIMULATION_STATE_GETTING,
        ids.SIMULATION_STATE_SETTING,
        ids.SIMULATION_STATE_PAUSE,
        ids.STEP_SIMULATION_SINGLE,
        ids.STEP_SIMULATION_MULTIPLE,
    }
    assert 'time continues' in features.custom_info
    assert offered(client, *OURS, *STANDARD.values()) == OURS | {
        name: f'simulation_interfaces/srv/{kind}' for kind, name in STANDARD.items()
    }


def test_a_type_that_is_missing_is_neither_offered_nor_listed(graph, client, standard):
    graph.start(
        'python',
        '-c',
        f'import sys, simulation_interfaces.srv as srv\ndel srv.StepSimulation\n{PLANT}',
    )
    features = standard.call('GetSimulatorFeatures').features.features
    assert not {
        standard.msg.SimulatorFeatures.STEP_SIMULATION_SINGLE,
        standard.msg.SimulatorFeatures.STEP_SIMULATION_MULTIPLE,
    } & set(features)
    kept = STANDARD.keys() - {'StepSimulation'}
    assert offered(client, *OURS, *(STANDARD[kind] for kind in kept)) == OURS | {
        STANDARD[kind]: f'simulation_interfaces/srv/{kind}' for kind in kept
    }


def test_a_plant_is_paused_and_played_and_other_states_are_refused(graph, client, standard):
    process = paused(graph, client)
    states, already = standard.states, standard.srv.SetSimulationState.Response
    assert standard.state == states.STATE_PAUSED
    assert standard.set(states.STATE_PAUSED).result == already.ALREADY_IN_TARGET_STATE
    for refused in (states.STATE_STOPPED, states.STATE_NO_WORLD, 99):
        result = standard.set(refused)
        assert result.result == standard.results.RESULT_FEATURE_UNSUPPORTED
        assert f'state = {refused}: must be playing (1)' in result.error_message
    assert standard.state == states.STATE_PAUSED
    seen = client.listen('/joint_states', JointState)
    assert standard.set(states.STATE_PLAYING).result == standard.results.RESULT_OK
    client.spin_until(lambda: len(seen) > 3, 'more states')
    assert standard.state == states.STATE_PLAYING
    assert standard.set(states.STATE_PLAYING).result == already.ALREADY_IN_TARGET_STATE
    finish(client, process)


def test_steps_are_made_while_paused_and_refused_while_playing(graph, client, standard):
    process = paused(graph, client)
    seen = client.listen('/joint_states', JointState)
    client.spin_until(lambda: seen, 'the state that is held')
    held = seen[-1].header.stamp.nanosec

    def made():
        return {state.header.stamp.nanosec for state in seen} - {held}

    result = standard.call('StepSimulation', once=True, steps=7).result
    assert result.result == standard.results.RESULT_OK
    assert '7 steps requested at 1.0' in result.error_message
    client.spin_until(lambda: len(made()) >= 7, 'seven states')
    assert standard.state == standard.states.STATE_PAUSED
    assert len(made()) == 7
    standard.set(standard.states.STATE_PLAYING)
    result = standard.call('StepSimulation').result
    assert result.result == standard.results.RESULT_OPERATION_FAILED
    assert result.error_message == 'steps = 1 is refused while playing: pause first'
    finish(client, process)


@pytest.mark.parametrize('scope', ['SCOPE_STATE', 'SCOPE_DEFAULT'])
def test_a_reset_of_the_state_lets_time_go_on(graph, client, standard, scope):
    process = paused(graph, client)
    scopes = standard.srv.ResetSimulation.Request
    result = standard.call('ResetSimulation', once=True, scope=getattr(scopes, scope)).result
    assert result.result == standard.results.RESULT_OK
    for refused in (
        scopes.SCOPE_TIME,
        scopes.SCOPE_ALL,
        scopes.SCOPE_SPAWNED,
        scopes.SCOPE_STATE | scopes.SCOPE_SPAWNED,
    ):
        refusal = standard.call('ResetSimulation', scope=refused).result
        assert refusal.result == standard.results.RESULT_FEATURE_UNSUPPORTED
        assert f'scope = {refused}' in refusal.error_message
        assert 'time never goes back' in refusal.error_message
    run = finish(client, process)
    started = np.flatnonzero(run.states['is_reset'])
    assert len(started) == 2
    assert f'{run.states["stamp"][started[1]] / SECOND:.9f}' in result.error_message


def test_there_is_nothing_to_reset_before_the_first_state(graph, standard):
    graph.start('plant_simulator', wait_for_recorder=True)
    result = standard.call(
        'ResetSimulation', scope=standard.srv.ResetSimulation.Request.SCOPE_STATE
    ).result
    assert result.result == standard.results.RESULT_INCORRECT_STATE
    assert result.error_message == 'scope = 2: there is no run yet'


def finish_quit(client, process):
    """Wait for the end that was asked for; returns the recording."""
    client.spin_until(lambda: not process.running, 'the end')
    assert process.wait() == 0, process.output
    assert 'the run is over' in process.output
    run = read_bag(process.folder / 'bag')
    assert_whole(run)
    assert len(run.states) == len(run.commands)
    return run


def test_quitting_ends_a_paused_run_with_a_whole_recording(graph, client, standard):
    process = paused(graph, client)
    standard.quit()
    assert len(finish_quit(client, process).states) > 20


def test_quitting_ends_a_run_at_full_speed_with_a_whole_recording(graph, client, standard):
    process = composed(graph, **{'plant_simulator:real_time_factor': 0.0})
    seen = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(seen) > 100, 'states')
    standard.quit()
    finish_quit(client, process)


def test_while_the_end_waits_for_a_command_the_run_is_quitting_and_nothing_else(
    graph, client, standard
):
    plant = start_plant(graph, command_timeout=60.0)
    publisher = client.node.create_publisher(JointState, '/joint_commands', 10)
    seen = client.listen('/joint_states', JointState)
    client.spin_until(lambda: seen, 'the first state')
    states, results = standard.states, standard.results
    codes = standard.srv.SetSimulationState.Response
    assert standard.set(states.STATE_QUITTING).result in (
        results.RESULT_OK,
        codes.ALREADY_IN_TARGET_STATE,
    )
    assert standard.state == states.STATE_QUITTING
    assert standard.set(states.STATE_QUITTING).result == codes.ALREADY_IN_TARGET_STATE
    for refusal, code in (
        (standard.set(states.STATE_PAUSED), codes.INCORRECT_TRANSITION),
        (standard.call('StepSimulation').result, results.RESULT_OPERATION_FAILED),
        (standard.call('ResetSimulation').result, results.RESULT_INCORRECT_STATE),
    ):
        assert refusal.result == code
        assert refusal.error_message.endswith(': the run is ending')
    command = JointState(header=seen[0].header, name=['axis'], effort=[0.0])
    publisher.publish(command)
    client.spin_until(lambda: not plant.running, 'the end')
    assert plant.wait() == 0, plant.output
    assert 'the run is over at 1.000000000 s' in plant.output


def test_quitting_ends_a_plant_that_waits_for_its_first_state(graph, client, standard):
    plant = graph.start('plant_simulator', wait_for_recorder=True)
    assert standard.state == standard.states.STATE_PLAYING
    standard.quit()
    client.spin_until(lambda: not plant.running, 'the end')
    assert plant.wait() == 0, plant.output


def test_quitting_ends_a_plant_whose_controller_is_gone(graph, client, standard):
    plant = start_plant(graph, real_time_factor=0.05)
    controller = graph.start('controller', config=UNDERDAMPED)
    seen = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(seen) > 20, 'states')
    controller.kill()
    standard.quit()
    client.spin_until(lambda: not plant.running, 'the end')
    assert plant.wait() == 0, plant.output
    assert 'the run is over' in plant.output
    assert 'Traceback' not in plant.output


def test_without_the_package_a_plant_offers_its_own_services_and_says_nothing(graph, client):
    plant = graph.start(
        'python', '-c', f'import sys; sys.modules["simulation_interfaces"] = None\n{PLANT}'
    )
    assert offered(client, *OURS) == OURS
    assert client.call('/plant_simulator/pause', SetBool, data=True).success
    assert plant.interrupt() == 0, plant.output
    assert 'simulation_interfaces' not in plant.output


def test_a_package_of_another_build_is_warned_about_and_costs_no_other_service(graph, client):
    package = graph.folder / 'simulation_interfaces'
    for folder in (package, package / 'msg', package / 'srv'):
        folder.mkdir()
        (folder / '__init__.py').touch()
    path = os.pathsep.join(filter(None, (str(graph.folder), os.environ.get('PYTHONPATH'))))
    graph.environment = {**graph.environment, 'PYTHONPATH': path}
    plant = start_plant(graph)
    assert offered(client, *OURS) == OURS
    assert 'the services of simulation_interfaces are not offered: cannot im' in plant.output
