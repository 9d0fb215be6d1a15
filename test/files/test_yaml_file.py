"""YAML as rcl and YAML 1.1, which rclpy and ros2 use, read it."""

from hypothesis import example, given, strategies as st
import yaml

from impulse_control_ros.files.saved_parameters import nested
from impulse_control_ros.files.yaml_file import as_text, flattened, parsed

TEXTS = st.text(st.characters(exclude_categories=['C', 'Z']), max_size=8) | st.from_regex(
    r'[-+]?[0-9]{1,2}\.?[0-9]?([eE][-+]?[0-9])?', fullmatch=True
)
FLOATS = st.floats(allow_nan=False)
INTEGERS = st.integers(-(2**63), 2**63 - 1)
VALUES = (
    TEXTS
    | FLOATS
    | INTEGERS
    | st.booleans()
    | st.lists(TEXTS)
    | st.lists(FLOATS)
    | st.lists(INTEGERS)
)
NAMES = st.from_regex(r'[a-c_]\w{0,5}(\.[A-C]\w{0,5}){0,2}', fullmatch=True)


def typed(values):
    return [(name, type(value), value) for name, value in sorted(values.items())]


@given(st.dictionaries(NAMES, VALUES))
@example({'y': '1e-6', 'n': 1e-6, 'text': 'off', 'day': '2024-01-01', 'time': '1:30', 'none': ''})
@example({'a': '', 'a.A': 1, 'b.B': 2})
def test_what_is_written_is_read_with_the_same_types_by_ros_and_by_yaml_1_1(values):
    text = as_text({'/node': {'ros__parameters': nested(values)}})
    for read in (parsed, yaml.safe_load):
        assert typed(flattened(read(text)['/node']['ros__parameters'])) == typed(values)
