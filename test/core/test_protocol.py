"""
The protocol under every interleaving of one plant, two controllers and a recorder.

protocol_model/ wraps the decisions of core/protocol.py as the nodes do. A breadth-first search
goes through all worlds that a `Scenario` allows: so many faults (a message that is lost, a process
that is killed, a timeout that fires early), up to a tick. It is exhaustive within this bound, and
asserts of each world:

1. For a state one effort acts, which was made for this state.
2. Whenever plant and a controller live and faults have stopped, the plant steps: a fair schedule,
   which delivers everything and then fires timeouts, is followed from each world.
3. So it does beside a recorder; that of a dead one is dropped (the same schedule).
4. A joined recorder gets each state and each command of a controller that lives; the effort that
   it records is the one that acted, or it counts it as missing.
5. Ticks go on by one, and a state names the author of the command that acted before it when it is
   first published.
6. Without faults no memory is cleared, and the standby is silent from the second state on.
7. Whoever acted last and hears of no other keeps its memory; one that was told of another forgets
   it, as at a reset or a gap.

Each of `MUTANTS`, a decision with a rule left out, breaks one of them. What the nodes build of the
decisions is led through random walks of the model.
"""

from random import Random
from typing import NamedTuple

import pytest

from impulse_control_ros.core import protocol
from test.core.protocol_model import processes
from test.core.protocol_model.moves import moves, start
from test.core.protocol_model.mutants import MUTANTS
from test.core.protocol_model.nodes import Nodes
from test.core.protocol_model.recorder import require
from test.core.protocol_model.search import search
from test.core.protocol_model.world import Bound

BOTH, ONE, FOREIGN_TOO = ('A1', 'B1'), ('A1',), ('A1', protocol.FOREIGN)


@pytest.mark.parametrize(
    ('header', 'frame_id'),
    [
        (('0123abcd', 2, '/c#1', '', ''), 'run:0123abcd.2 /c#1'),
        (('0123abcd', 2, '/c#1', 'sticking', ''), 'run:0123abcd.2 /c#1 sticking'),
        (('0123abcd', 2, '/c#1', '', 'absent'), 'run:0123abcd.2 /c#1 - absent'),
        (
            ('0123abcd', 2, '/c#1', 'sticking', 'confirmed'),
            'run:0123abcd.2 /c#1 sticking confirmed',
        ),
        (('', 0, protocol.FOREIGN, 'sticking', ''), 'sticking'),
        (('', 0, protocol.FOREIGN, '', 'absent'), '- absent'),
        (('', 0, protocol.FOREIGN, 'sticking', 'absent'), 'sticking absent'),
        (('', 0, protocol.FOREIGN, 'base link of axis', ''), 'base link of axis'),
    ],
)
def test_the_header_of_a_command_is_read_as_it_was_written(header, frame_id):
    made = protocol.CommandHeader(*header)
    assert made.frame_id == frame_id
    assert protocol.parse_command(frame_id) == made
    assert made.has_event == bool(made.guard or made.verdict)


class Scenario(NamedTuple):
    """Who takes part, what may happen up to ``last_tick``, and how many worlds that are."""

    controllers: tuple[str, ...]
    recorder: str
    bound: Bound
    last_tick: int
    worlds: int

    def search(self):
        return search(start(self.controllers, self.recorder, self.bound), self.last_tick)


SCENARIOS = {
    'without faults': Scenario(BOTH, '', Bound(copies=2), 3, 2_500),
    'with messages out of order': Scenario(BOTH, '', Bound(copies=1, overtakes=1), 2, 1_200),
    'with two faults': Scenario(BOTH, '', Bound(faults=2), 1, 32_000),
    'with a reset': Scenario(BOTH, '', Bound(faults=1, resets=1), 2, 11_000),
    'beside a foreign controller': Scenario(FOREIGN_TOO, '', Bound(faults=1, copies=1), 2, 6_500),
    'with one controller and a recorder': Scenario(
        ONE, 'R1', Bound(faults=1, resets=1, unheard=1), 2, 22_000
    ),
    'with a recorder': Scenario(BOTH, 'R1', Bound(faults=1), 1, 31_000),
    'with a recorder that is discovered late': Scenario(
        BOTH, 'R1', Bound(copies=1, unheard=2), 1, 19_000
    ),
}
LONG = {
    'with two faults, longer': Scenario(BOTH, '', Bound(faults=2), 2, 140_000),
    'with three faults': Scenario(BOTH, '', Bound(faults=3), 1, 790_000),
    'with copies and a reset': Scenario(BOTH, '', Bound(faults=1, copies=1, resets=1), 2, 100_000),
    'with one controller, a recorder and two faults': Scenario(
        ONE, 'R1', Bound(faults=2, unheard=1), 2, 185_000
    ),
    'with a recorder, longer': Scenario(BOTH, 'R1', Bound(faults=1), 2, 120_000),
    'with a recorder that is discovered late, and a fault': Scenario(
        BOTH, 'R1', Bound(faults=1, unheard=1), 1, 110_000
    ),
}
ENDLESS_SEARCH = {  # too many worlds for all of them; a mutant is caught in the first ones
    'with three faults, longer': Scenario(BOTH, '', Bound(faults=3), 2, 0),
}


@pytest.fixture(autouse=True)
def small_window(monkeypatch):
    monkeypatch.setattr(protocol, 'WINDOW', 2)


@pytest.mark.parametrize(
    'name', [*SCENARIOS, *(pytest.param(name, marks=pytest.mark.soak) for name in LONG)]
)
def test_no_interleaving_breaks_a_rule(name):
    scenario = (SCENARIOS | LONG)[name]
    found = scenario.search()
    assert not found.broken, '\n'.join([found.broken, *found.trace])
    assert found.worlds >= scenario.worlds, f'{found.worlds} worlds'


def test_a_memory_holds_what_acted_but_for_two_faults_at_once(monkeypatch):
    """
    The known gap: A's command is lost or too late, B's acts; A misses the state that names B.

    B is silent, so the plant names nobody, and A goes on with a memory of what did not act.
    """

    def check_memory(world, command):
        *_, before = world.acted or [None]
        require(
            len(command.memory) == 1 or before.header == command.header,
            'a memory holds what acted',
        )

    monkeypatch.setattr(processes, 'check_memory', check_memory)
    assert not SCENARIOS['with a reset'].search().broken  # and one fault
    assert SCENARIOS['with two faults'].search().broken == 'a memory holds what acted'


@pytest.mark.parametrize(
    ('place', 'mutant', 'scenario', 'number'),
    [
        pytest.param(place, mutant, *caught, id=mutant.__name__.replace('_', ' '))
        for place, mutants in MUTANTS.items()
        for mutant, caught in mutants.items()
    ],
)
def test_no_mutant_survives(monkeypatch, place, mutant, scenario, number):
    monkeypatch.setattr(*place, mutant)
    found = (SCENARIOS | ENDLESS_SEARCH)[scenario].search()
    assert found.broken[:1] == number, '\n'.join([found.broken, *found.trace])


def test_the_arbiters_and_the_joiner_do_on_random_walks_what_the_model_does():
    for seed in range(100):
        random, nodes = Random(seed), Nodes()
        bound = Bound(faults=4, copies=3, resets=1, unheard=2)
        world = random.choice([*start(BOTH, 'R1', bound)])
        for _ in range(60):
            found = [*moves(world)]
            likely = [move for move in found if move[1].bound.faults == world.bound.faults]
            what, after = random.choice(likely if random.random() < 0.8 else found)
            nodes.follow(what, world, after)
            world = after
