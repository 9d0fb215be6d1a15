"""Start a controller manager, with our controller above it and our plant below it."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import LifecycleNode, LifecycleTransition, Node
from launch_ros.parameter_descriptions import ParameterValue
from lifecycle_msgs.msg import Transition

HERE = Path(__file__).resolve().parent
AXIS, CONTROLLERS = str(HERE / 'axis.yaml'), str(HERE / 'controllers.yaml')
PACKAGE = 'impulse_control_ros'


def manager():
    """Yield the manager, its description of the robot, and the spawner of its controllers."""
    description = {'robot_description': (HERE / 'axis.urdf').read_text()}
    yield Node(
        package='robot_state_publisher',
        executable='robot_state_publisher',
        parameters=[description],
    )
    yield Node(
        package='controller_manager',
        executable='ros2_control_node',
        parameters=[CONTROLLERS, clock()],
        output='screen',
    )
    spawner = Node(
        package='controller_manager',
        executable='spawner',
        arguments=[
            'joint_state_broadcaster',
            LaunchConfiguration('controller'),
            '--param-file',
            CONTROLLERS,
        ],
        output='screen',
    )
    yield spawner
    activate = LifecycleTransition(
        lifecycle_node_names=['/controller'],
        transition_ids=[Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE],
        condition=IfCondition(ours()),
    )
    yield RegisterEventHandler(OnProcessExit(target_action=spawner, on_exit=[activate]))


def clock():
    """Return the choice of the clock, which the hardware of the manager needs as well."""
    return {'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)}


def ours():
    """Return whether our controller is the one to act."""
    return EqualsSubstitution(LaunchConfiguration('controller'), 'forward_effort_controller')


def nodes():
    """Yield our controller, plant and recorder."""
    yield LifecycleNode(
        package=PACKAGE,
        executable='controller',
        name='controller',
        namespace='/',
        parameters=[AXIS, clock()],
        remappings=[('effort_commands', '/forward_effort_controller/commands')],
        output='screen',
        condition=IfCondition(ours()),
    )
    yield Node(
        package=PACKAGE,
        executable='plant_simulator',
        namespace='/hardware',
        parameters=[AXIS],
        output='screen',
        condition=IfCondition(LaunchConfiguration('plant')),
    )
    bag = LaunchConfiguration('bag')
    yield Node(
        package=PACKAGE,
        executable='recorder',
        namespace='/hardware',
        parameters=[AXIS, {'bag': ParameterValue(bag, value_type=str)}],
        output='screen',
        condition=IfCondition(NotEqualsSubstitution(bag, '')),
    )


def generate_launch_description():
    """Return the arguments and the processes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'controller',
                default_value='forward_effort_controller',
                choices=['forward_effort_controller', 'pid_controller'],
                description='pid_controller instead of our controller, to compare',
            ),
            DeclareLaunchArgument(
                'plant',
                default_value='true',
                choices=['true', 'false'],
                description='false for hardware of your own',
            ),
            DeclareLaunchArgument(
                'use_sim_time',
                default_value='false',
                choices=['true', 'false'],
                description='whether the manager runs by the /clock of our plant',
            ),
            DeclareLaunchArgument(
                'bag', default_value='', description='folder to record into; empty for none'
            ),
            *nodes(),
            *manager(),
        ]
    )
