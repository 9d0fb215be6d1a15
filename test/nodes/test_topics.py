"""Our CDR and rclpy's, and what happens where they differ."""

import subprocess
import sys

import pytest

from impulse_control_ros.files.cdr import FIELDS, JointStateLayout
from impulse_control_ros.files.recording import read
from impulse_control_ros.nodes.topics import TypedLayout, verified
from test.conftest import CONFIG, ROOT


class Log:
    def __init__(self):
        self.errors = []

    def error(self, text):
        self.errors.append(text)


@pytest.mark.parametrize('joint', ['axis', 'a', 'elbow_7', 'gelenk_ä'])
@pytest.mark.parametrize('frame_id', ['', 'reset', 'position_zero'])
@pytest.mark.parametrize('fields', [FIELDS, ('effort',)])
def test_the_fast_layout_is_rclpys_in_both_directions(joint, frame_id, fields):
    log, fast = Log(), JointStateLayout(joint, frame_id, fields)
    assert verified(fast, log) is fast
    assert log.errors == []


def test_a_layout_that_rclpy_does_not_share_is_named_and_replaced_by_the_slow_one():
    log, wrong = Log(), JointStateLayout('axis')
    wrong.joint = 'elbow'
    slow = verified(wrong, log)
    assert isinstance(slow, TypedLayout)
    assert "'elbow'" in log.errors[0]
    assert len(log.errors) == 1
    raw = slow.encode(1, 2, 3.0, 4.0, 5.0)
    assert JointStateLayout('elbow').decode(raw) == slow.decode(raw) == (1, 2, 3.0, 4.0, 5.0)


@pytest.mark.parametrize('raw', [b'', b'\x00\x01\x00\x00', JointStateLayout('knee').encode(
    1, 2, 3.0, 4.0, 5.0), JointStateLayout('axis', 'reset').encode(1, 2, 3.0, 4.0, 5.0)])
def test_the_slow_layout_refuses_what_the_fast_one_refuses(raw):
    assert JointStateLayout('axis').decode(raw) is None
    assert TypedLayout('axis', '', FIELDS).decode(raw) is None


@pytest.mark.parametrize('hidden', ['rclpy.experimental', 'no_such_module'])
def test_without_the_events_executor_the_standard_one_serves_and_says_so(graph, hidden):
    bag = graph.folder / 'bag'
    code = (f'import sys; sys.modules[{hidden!r}] = None\n'
            'from impulse_control_ros.nodes.entry import closed_loop; sys.exit(closed_loop())')
    done = subprocess.run(
        [sys.executable, '-c', code, '--ros-args', '--params-file',
         str(CONFIG / 'underdamped.yaml'), '-p', f'recorder:bag:={bag}'],
        env=graph.env, cwd=ROOT, capture_output=True, text=True, check=True)
    assert ('no EventsExecutor' in done.stderr) == (hidden == 'rclpy.experimental')
    run = read(bag)
    assert (len(run.states), run.receipt['missing']) == (20_001, '0')
