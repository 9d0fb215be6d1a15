"""Start plant, controller and recorder as three processes from one parameter file."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'impulse_control_ros'


def generate_launch_description():
    """Return the three nodes; the end of the plant ends all."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'underdamped.yaml'])
    arguments = [
        DeclareLaunchArgument(
            'params_file', default_value=config, description='a ROS parameter file'
        ),
        DeclareLaunchArgument(
            'bag', default_value='', description='folder to create; empty: impulse_<date and time>'
        ),
    ]
    params = LaunchConfiguration('params_file')
    bag = {'bag': LaunchConfiguration('bag')}
    nodes = [
        Node(
            package=PACKAGE,
            executable=name,
            name=name,
            output='screen',
            parameters=[params, bag] if name == 'recorder' else [params],
        )
        for name in ('plant_simulator', 'controller', 'recorder')
    ]
    done = RegisterEventHandler(
        OnProcessExit(
            target_action=nodes[0], on_exit=[EmitEvent(event=Shutdown(reason='the run is over'))]
        )
    )
    return LaunchDescription([*arguments, *nodes, done])
