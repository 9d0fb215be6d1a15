"""Message definitions as rosbag2 stores them, from the interface files of ROS packages."""

import json
import os
from pathlib import Path
import re
import sys

SEPARATOR = '\n' + '=' * 80 + '\nMSG: '
PRIMITIVE = re.compile(r'(bool|byte|char|float32|float64|u?int(8|16|32|64)|w?string)\b')
FIELD = re.compile(r'^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+')


def interface_file(package: str, name: str) -> Path:
    """Return an interface file, e.g. Header.msg; raise `FileNotFoundError` that names it."""
    prefixes = [
        *filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)),
        sys.prefix,
    ]
    for prefix in prefixes:
        path = Path(prefix, 'share', package, 'msg', name)
        if path.is_file():
            return path
    raise FileNotFoundError(f'{package}/msg/{name} is in none of {", ".join(prefixes)}')


def message_definition(message_type: str) -> str:
    """
    Return the full ``ros2msg`` text of e.g. ``sensor_msgs/msg/JointState``.

    The type's own file comes first, then every type it needs, each behind a separator line.
    """
    package, name = message_type.split('/')[0], message_type.split('/')[-1]
    text = interface_file(package, f'{name}.msg').read_text(encoding='utf-8')
    seen, waiting = {(package, name)}, dependencies(package, text)
    while waiting:
        wanted = waiting.pop(0)
        if wanted in seen:
            continue
        seen.add(wanted)
        inner = interface_file(wanted[0], f'{wanted[1]}.msg').read_text(encoding='utf-8')
        text += SEPARATOR + '/'.join(wanted) + '\n' + inner
        waiting += dependencies(wanted[0], inner)
    return text


def type_hash(message_type: str) -> str:
    """Return the RIHS01 hash of e.g. ``sensor_msgs/msg/JointState``."""
    package, _, name = message_type.split('/')
    hashes = json.loads(interface_file(package, f'{name}.json').read_text(encoding='utf-8'))[
        'type_hashes'
    ]
    return str(next(item['hash_string'] for item in hashes if item['type_name'] == message_type))


def dependencies(package: str, text: str) -> list[tuple[str, str]]:
    """List the (package, name) of the types that the fields of a .msg text use."""
    found = []
    for line in text.splitlines():
        field = FIELD.match(line.split('#')[0])
        if field and not PRIMITIVE.match(field[1]):
            parts = field[1].split('/')
            found.append((parts[0] if len(parts) > 1 else package, parts[-1]))
    return found
