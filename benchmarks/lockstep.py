"""
Measure the lockstep against the floor of the middleware, in one run.

    python benchmarks/lockstep.py [--json] [--rounds N]

The floors exchange the same raw messages with the same QoS and do no control work: publish and
take on one thread (composed_floor), and two processes on the EventsExecutor (two_process_floor).
Cases are interleaved; each figure is the median of the rounds, in steps (state out, command
back) per second of wall time. Peak RSS is the operating system's figure for the process.
"""

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
import re
import signal
from statistics import median
import subprocess
import sys
import tempfile
import time

BIN = Path(sys.executable).parent
CONFIG = Path(__file__).parent.parent / 'config' / 'underdamped.yaml'
COMPOSED_SECONDS, PROCESS_SECONDS = 5.0, 1.0
STEPS_PER_SECOND = 10_000
RUN_OVER = re.compile(r'([\d.]+) s in ([\d.]+) s of wall')


class Child:
    """A process, its output, and once it has ended its peak RSS in MB."""

    def __init__(self, *command: object) -> None:
        self._out = tempfile.TemporaryFile('w+')  # noqa: SIM115 (read once the child has ended)
        self._popen = subprocess.Popen([str(word) for word in command], stdout=self._out,
                                       stderr=self._out, start_new_session=True)
        self.peak = 0.0

    def wait(self) -> str:
        """Return what it said."""
        _, status, usage = os.wait4(self._popen.pid, 0)
        self._popen.returncode = os.waitstatus_to_exitcode(status)
        self.peak = usage.ru_maxrss / 1024
        self._out.seek(0)
        said = self._out.read()
        if self._popen.returncode:
            sys.exit(f'{self._popen.args} failed:\n{said}')
        return said

    def interrupt(self) -> str:
        """End it with Ctrl-C."""
        self._popen.send_signal(signal.SIGINT)
        return self.wait()


def steps_per_second(said: str) -> float:
    """Return the rate from the plant's last words."""
    simulated, wall = map(float, RUN_OVER.search(said).groups())
    return simulated * STEPS_PER_SECOND / wall


def node(name: str, seconds: float, *arguments: str) -> Child:
    """Start one of our executables on the benchmark's experiment."""
    plant = 'plant_simulator:' if name == 'closed_loop' else ''
    duration = () if name in ('controller', 'recorder') else (
        '-p', f'{plant}duration:={seconds}')
    own = [word for word in arguments if word.startswith('--')]
    return Child(BIN / name, *own, '--ros-args', '--params-file', CONFIG, *duration,
                 *(word for word in arguments if word not in own))


def composed(folder: Path, recorded: bool, seconds: float = COMPOSED_SECONDS
             ) -> tuple[float, dict[str, float]]:
    """Measure closed_loop."""
    arguments = (('-p', f'recorder:bag:={folder / "bag"}') if recorded else ('--no-recorder',))
    child = node('closed_loop', seconds, *arguments)
    return steps_per_second(child.wait()), {'closed_loop': child.peak}


def processes(folder: Path, recorded: bool) -> tuple[float, dict[str, float]]:
    """Measure plant and controller, and a recorder beside them, as processes."""
    wait = str(recorded).lower()
    children = {'plant_simulator': node('plant_simulator', PROCESS_SECONDS, '-p',
                                        f'wait_for_recorder:={wait}'),
                'controller': node('controller', PROCESS_SECONDS)}
    if recorded:
        children['recorder'] = node('recorder', PROCESS_SECONDS, '-p', f'bag:={folder / "bag"}')
    rate = steps_per_second(children['plant_simulator'].wait())
    for name in list(children)[1:]:
        children[name].interrupt()
    return rate, {name: child.peak for name, child in children.items()}


def composed_floor(_: Path) -> tuple[float, dict[str, float]]:
    """Measure publish and take on one thread."""
    child = Child(sys.executable, __file__, '--child', 'composed')
    return float(child.wait()), {'floor': child.peak}


def two_process_floor(_: Path) -> tuple[float, dict[str, float]]:
    """Measure two processes on the EventsExecutor that send each message back."""
    echo = Child(sys.executable, __file__, '--child', 'echo')
    ping = Child(sys.executable, __file__, '--child', 'ping')
    rate = float(ping.wait())
    echo.interrupt()
    return rate, {'ping': ping.peak, 'echo': echo.peak}


CASES: dict[str, Callable[[Path], tuple[float, dict[str, float]]]] = {
    'composed_floor': composed_floor,
    'composed': lambda folder: composed(folder, recorded=False),
    'composed_recorded': lambda folder: composed(folder, recorded=True),
    'two_process_floor': two_process_floor,
    'two_process': lambda folder: processes(folder, recorded=False),
    'three_process': lambda folder: processes(folder, recorded=True),
}
FLOORS = {'composed': 'composed_floor', 'composed_recorded': 'composed_floor',
          'two_process': 'two_process_floor', 'three_process': 'two_process_floor'}


def run_child(role: str) -> None:
    """Be a floor: the raw messages of the nodes, and nothing else."""
    import rclpy
    from rclpy.experimental import EventsExecutor
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState

    from impulse_control_ros.files.cdr import JointStateLayout
    from impulse_control_ros.nodes.topics import SERIES_QOS

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopped = []
    signal.signal(signal.SIGINT, lambda *_: stopped.append(True))
    state = JointStateLayout('axis').encode(1, 0, 0.5, 0.0, 0.0)
    command = JointStateLayout('axis', '', ('effort',)).encode(1, 0, 5.0)
    count = [0]

    def make(name: str, out: str, into: str, reply: bytes) -> tuple[object, object, object]:
        made = rclpy.create_node(name)
        publisher = made.create_publisher(JointState, out, SERIES_QOS)

        def on_message(_: bytes) -> None:
            count[0] += 1
            publisher.publish(reply)
        return made, publisher, made.create_subscription(
            JointState, into, on_message, SERIES_QOS, raw=True)

    plant = make('plant', 'joint_states', 'joint_commands', state) if role != 'echo' else None
    controller = (make('controller', 'joint_commands', 'joint_states', command)
                  if role != 'ping' else None)

    def matched() -> bool:
        return all(end is None or (end[1].get_subscription_count()
                                   and end[2].get_publisher_count())
                   for end in (plant, controller))
    while not matched():
        time.sleep(0.01)

    executor = None
    if role == 'composed':
        steps = int(COMPOSED_SECONDS * STEPS_PER_SECOND)
        began = time.perf_counter()
        for _ in range(steps):
            plant[1].publish(state)
            with controller[2].handle:
                controller[2].handle.take_message(JointState, True)
            controller[1].publish(command)
            with plant[2].handle:
                plant[2].handle.take_message(JointState, True)
    else:
        executor = EventsExecutor()
        executor.add_node((plant or controller)[0])
        steps = int(PROCESS_SECONDS * STEPS_PER_SECOND)
        again = began = time.perf_counter()
        while not stopped and (role == 'echo' or count[0] < steps):
            if role == 'ping' and not count[0] and time.perf_counter() >= again:
                plant[1].publish(state)
                again = time.perf_counter() + 1.0
                began = time.perf_counter()
            executor.spin_once(timeout_sec=0.1)
    if role != 'echo':
        print(steps / (time.perf_counter() - began))
    if executor:
        executor.shutdown()
    for end in (plant, controller):
        if end:
            end[0].destroy_node()
    rclpy.shutdown()


def memory_growth(long: float) -> dict[str, float]:
    """Return the peak RSS [MB] of recorded runs of 10 s and ``long`` of simulated time."""
    peaks = {}
    for seconds in (10.0, long):
        with tempfile.TemporaryDirectory() as folder:
            _, peak = composed(Path(folder), recorded=True, seconds=seconds)
        peaks[f'{seconds:g}_s'] = peak['closed_loop']
    return peaks


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--rounds', type=int, default=9)
    parser.add_argument('--long', type=float, default=60.0, help='simulated time [s]')
    parser.add_argument('--child', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        run_child(options.child)
        return
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rates: dict[str, list[float]] = {name: [] for name in CASES}
    peaks: dict[str, dict[str, float]] = {}
    for _ in range(options.rounds):
        for name, measure in CASES.items():
            with tempfile.TemporaryDirectory() as folder:
                rate, peaks[name] = measure(Path(folder))
            rates[name].append(rate)
    result = {name: median(values) for name, values in rates.items()}
    growth = memory_growth(options.long)
    if options.json:
        print(json.dumps(result | {'peak_rss_mb': peaks, 'growth_rss_mb': growth}, indent=2))
        return
    print(f'{"case":<20}{"steps/s":>10}{"ours/floor":>12}{"x real time":>13}  peak RSS [MB]')
    for name, rate in result.items():
        ratio = f'{rate / result[FLOORS[name]]:.2f}' if name in FLOORS else ''
        memory = ', '.join(f'{part} {size:.0f}' for part, size in peaks[name].items())
        print(f'{name:<20}{rate:>10.0f}{ratio:>12}{rate / STEPS_PER_SECOND:>13.2f}  {memory}')
    print('recorded runs, peak RSS [MB]: ' + ', '.join(
        f'{seconds.replace("_", " ")}: {size:.0f}' for seconds, size in growth.items()))


if __name__ == '__main__':
    main()
