import json
import os
from pathlib import Path
import subprocess
import sys

import pytest

from impulse_control_ros.errors import ParameterError
from impulse_control_ros.nodes.transport import (
    LOCALHOST_UDP,
    OWN_CHOICE,
    place_on_core,
    prefer_udp,
    PROFILES,
    RANGE,
    TRANSPORTS,
)
from test.processes import die_with_parent, free_domain

NODE = """
import rclpy
from rclpy.utilities import get_rmw_implementation_identifier

from impulse_control_ros.nodes.transport import prefer_udp

prefer_udp(get_rmw_implementation_identifier())
rclpy.init()
node = rclpy.create_node('node')  # as long as it lives, so does its transport
print('shared memory:', '/dev/shm/fastrtps' in open('/proc/self/maps').read())
"""
PROFILE = """
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles><participant profile_name="theirs" is_default_profile="true"><rtps/></participant>
  </profiles>
</dds>
"""
CORES = """
import json, os, threading, time

from impulse_control_ros.nodes.transport import place_on_core

threading.Thread(target=time.sleep, args=(5,), daemon=True).start()
core = max(os.sched_getaffinity(0))
place_on_core(core)
allowed = [sorted(os.sched_getaffinity(int(thread))) for thread in os.listdir('/proc/self/task')]
print(json.dumps([core, allowed]))
"""


def said_by(code, folder, **environment):
    """Return what Python says that runs ``code`` with no ROS variable but ``environment``."""
    inherited = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(('ROS_', 'RMW_', 'FAST'))
    }
    domain, claim = free_domain()
    with claim:
        return subprocess.run(
            [sys.executable, '-c', code],
            env=inherited | {'ROS_DOMAIN_ID': str(domain)} | environment,
            cwd=folder,
            preexec_fn=die_with_parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        ).stdout


@pytest.mark.parametrize(
    'environment',
    [
        {},
        {RANGE: 'SUBNET'},
        {RANGE: 'LOCALHOST'},
        {RANGE: 'SYSTEM_DEFAULT'},
        {'ROS_LOCALHOST_ONLY': '1'},
    ],
    ids=str,
)
def test_a_process_for_which_nothing_is_chosen_maps_no_shared_memory(environment, tmp_path):
    assert 'shared memory: False' in said_by(NODE, tmp_path, **environment)


@pytest.mark.parametrize(
    'environment',
    [
        {PROFILES[0]: 'theirs.xml'},
        {PROFILES[0]: 'theirs.xml', RANGE: 'LOCALHOST'},
        {TRANSPORTS: 'DEFAULT'},
    ],
    ids=str,
)
def test_a_process_keeps_the_transport_that_its_user_has_chosen(environment, tmp_path):
    (tmp_path / 'theirs.xml').write_text(PROFILE)
    assert 'shared memory: True' in said_by(NODE, tmp_path, **environment)


@pytest.mark.parametrize('name', OWN_CHOICE)
def test_variables_of_the_user_are_left_alone(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    environment = {name: 'theirs', RANGE: 'LOCALHOST'}
    prefer_udp('rmw_fastrtps_cpp', environment)
    assert environment == {name: 'theirs', RANGE: 'LOCALHOST'}


def test_a_profile_in_the_working_directory_and_other_middleware_are_left_alone(
    tmp_path, monkeypatch
):
    environment = {RANGE: 'LOCALHOST'}
    prefer_udp('rmw_cyclonedds_cpp', environment)
    monkeypatch.chdir(tmp_path)
    Path('DEFAULT_FASTRTPS_PROFILES.xml').write_text(PROFILE)
    prefer_udp('rmw_fastrtps_cpp', environment)
    assert environment == {RANGE: 'LOCALHOST'}


def test_the_range_off_stays_off(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    environment = {RANGE: 'OFF'}
    prefer_udp('rmw_fastrtps_cpp', environment)
    assert environment == {RANGE: 'OFF', TRANSPORTS: 'UDPv4'}


def test_our_profile_is_part_of_the_package():
    assert LOCALHOST_UDP.is_file()


def test_a_placed_process_runs_on_its_core_with_all_its_threads(tmp_path):
    core, allowed = json.loads(said_by(CORES, tmp_path))
    assert len(allowed) > 1
    assert set(map(tuple, allowed)) == {(core,)}


def test_a_core_that_is_not_there_is_refused_with_those_that_are():
    before = os.sched_getaffinity(0)
    place_on_core(-1)
    with pytest.raises(ParameterError, match=r'^invalid cpu_core = 999: must be -1 .* one of 0'):
        place_on_core(999)
    assert os.sched_getaffinity(0) == before
