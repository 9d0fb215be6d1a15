"""
The transport of a process, and its CPU core.

By default Fast DDS uses shared memory between processes on one machine. If a process is killed,
the others can hang forever inside ``publish`` on a lock that it held. Otherwise they run at a
twentieth of the speed until DDS drops the process (20 s), and may not hear its replacement. UDP
avoids this but makes two processes a tenth slower: docs/concepts/fault-tolerance.md.
"""

from collections.abc import MutableMapping
from contextlib import suppress
import os
from pathlib import Path

from impulse_control_ros.errors import ParameterError

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
OWN_CHOICE = (TRANSPORTS, *PROFILES, 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER')
OWN_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')
LOCALHOST_UDP = Path(__file__).with_name('localhost_udp.xml')


def prefer_udp(middleware: str, environment: MutableMapping[str, str] = os.environ) -> None:
    """
    Use UDP only, unless the user has chosen a transport; call this before ``rclpy.init``.

    ``middleware`` is its name in rclpy. In the range LOCALHOST rmw_fastrtps adds shared memory
    regardless of ``TRANSPORTS``, so our own profile replaces that range.
    """
    if (
        not middleware.startswith('rmw_fastrtps')
        or any(map(environment.get, OWN_CHOICE))
        or any(map(os.path.exists, OWN_FILES))
    ):
        return
    environment[TRANSPORTS] = 'UDPv4'
    local_only = environment.get('ROS_LOCALHOST_ONLY') == '1'
    if local_only or environment.get(RANGE) == 'LOCALHOST':
        environment.update(dict.fromkeys(PROFILES, str(LOCALHOST_UDP)))
        environment[RANGE] = 'SYSTEM_DEFAULT'
        environment.pop('ROS_LOCALHOST_ONLY', None)


def place_on_core(core: int) -> None:
    """Run every thread of this process on one core; -1 leaves the choice to the system."""
    if core == -1:
        return
    allowed = os.sched_getaffinity(0)
    if core not in allowed:
        raise ParameterError(
            f'invalid cpu_core = {core}: must be -1 (any core) or one of '
            + ', '.join(map(str, sorted(allowed)))
        )
    for thread in os.listdir('/proc/self/task'):
        with suppress(ProcessLookupError):  # the thread has ended meanwhile
            os.sched_setaffinity(int(thread), {core})
