"""Start plant, controller and recorder as three processes from parameter files."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'impulse_control_ros'


def processes(context):
    """Return the three nodes; the end of the plant ends all."""
    files = LaunchConfiguration('params_file').perform(context).split(',')
    bag = {'bag': LaunchConfiguration('bag')}
    nodes = [
        Node(
            package=PACKAGE,
            executable=name,
            name=name,
            output='screen',
            parameters=[*files, bag] if name == 'recorder' else files,
        )
        for name in ('plant_simulator', 'controller', 'recorder')
    ]
    done = RegisterEventHandler(
        OnProcessExit(
            target_action=nodes[0], on_exit=[EmitEvent(event=Shutdown(reason='the run is over'))]
        )
    )
    return [*nodes, done]


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
            OpaqueFunction(function=processes),
        ]
    )
