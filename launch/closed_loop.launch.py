"""Start plant, controller and recorder as processes from parameter files."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'impulse_control_ros'
NODES = ('plant_simulator', 'controller', 'recorder')


def processes(context):
    """Return the nodes; the end of the plant ends all, and so does an error of any."""
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in ('params_file', 'bag', 'namespace', 'real_time_factor', 'record')
    }
    files = [existing(name) for name in given['params_file'].split(',')]
    records = given['record'] == 'true'
    values = {name: {} for name in NODES}
    if given['bag']:
        # launch would read 2024_01_01 as a number, and rcl 1e5
        bag = str(Path(given['bag']).expanduser().absolute())
        values['recorder']['bag'] = ParameterValue(bag, value_type=str)
    if given['real_time_factor']:
        values['plant_simulator']['real_time_factor'] = number(given['real_time_factor'])
    if not records:
        values['plant_simulator']['wait_for_recorder'] = False
    nodes = {
        name: Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=given['namespace'] or '/',
            output='screen',
            parameters=[*files, values[name]] if values[name] else files,
        )
        for name in (NODES if records else NODES[:-1])
    }
    return [*nodes.values(), *(on_exit(name, node) for name, node in nodes.items())]


def existing(name):
    """Return a parameter file; launch itself would go on without it."""
    path = Path(name).expanduser()
    if not path.is_file():
        raise RuntimeError(f'params_file: there is no file {path}')
    return str(path)


def number(text):
    """Return the real time factor."""
    try:
        return float(text)
    except ValueError:
        raise RuntimeError(f'invalid real_time_factor = {text!r}: must be a number') from None


def on_exit(name, node):
    """Return the handler of a node's end."""

    def end(event, _):
        if event.returncode:
            raise RuntimeError(f'{name} has failed (exit status {event.returncode})')
        if name == 'plant_simulator':
            return EmitEvent(event=Shutdown(reason='the run is over'))
        return None

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=end))


def generate_launch_description():
    """Return the arguments and the processes."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'underdamped.yaml'])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file',
                default_value=config,
                description='ROS parameter files, separated by commas; later ones count',
            ),
            DeclareLaunchArgument(
                'bag',
                default_value='',
                description='folder to create; empty: impulse_<date and time>',
            ),
            DeclareLaunchArgument(
                'namespace',
                default_value='',
                description='namespace of the nodes; /**/NAME in a file matches any',
            ),
            DeclareLaunchArgument(
                'real_time_factor',
                default_value='',
                description='simulated seconds per wall second; empty: as in params_file',
            ),
            DeclareLaunchArgument(
                'record',
                default_value='true',
                choices=['true', 'false'],
                description='false starts no recorder',
            ),
            OpaqueFunction(function=processes),
        ]
    )
