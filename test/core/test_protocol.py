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

Each of `MUTANTS`, a decision with a rule left out, breaks one of them.
"""

from random import Random
from typing import NamedTuple

import pytest

from impulse_control_ros.core import protocol
from impulse_control_ros.core.protocol import Answered, ENDLESS, Reply, RUN_TIMEOUT, Verdict
from test.core.protocol_model import processes, recorder
from test.core.protocol_model.moves import moves, start
from test.core.protocol_model.nodes import Nodes
from test.core.protocol_model.recorder import require
from test.core.protocol_model.search import search
from test.core.protocol_model.world import Bound

REAL = {name: getattr(protocol, name) for name in (
    'judge_command', 'judge_state', 'after_silence', 'step_limit')}
BOTH, ONE, FOREIGN_TOO = ('A1', 'B1'), ('A1',), ('A1', protocol.FOREIGN)


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
    'beside a foreign controller': Scenario(
        FOREIGN_TOO, '', Bound(faults=1, copies=1), 2, 6_500),
    'with one controller and a recorder': Scenario(
        ONE, 'R1', Bound(faults=1, resets=1, unheard=1), 2, 22_000),
    'with a recorder': Scenario(BOTH, 'R1', Bound(faults=1), 1, 31_000),
    'with a recorder that is discovered late': Scenario(
        BOTH, 'R1', Bound(copies=1, unheard=2), 1, 19_000),
}
LONG = {
    'with two faults, longer': Scenario(BOTH, '', Bound(faults=2), 2, 140_000),
    'with three faults': Scenario(BOTH, '', Bound(faults=3), 1, 790_000),
    'with copies and a reset': Scenario(BOTH, '', Bound(faults=1, copies=1, resets=1), 2, 100_000),
    'with one controller, a recorder and two faults': Scenario(
        ONE, 'R1', Bound(faults=2, unheard=1), 2, 190_000),
    'with a recorder, longer': Scenario(BOTH, 'R1', Bound(faults=1), 2, 120_000),
    'with a recorder that is discovered late, and a fault': Scenario(
        BOTH, 'R1', Bound(faults=1, unheard=1), 1, 110_000),
}
ENDLESS_SEARCH = {  # too many worlds for all of them; a mutant is caught in the first ones
    'with three faults, longer': Scenario(BOTH, '', Bound(faults=3), 2, 0),
}


@pytest.fixture(autouse=True)
def small_window(monkeypatch):
    monkeypatch.setattr(protocol, 'WINDOW', 2)


@pytest.mark.parametrize('name', [
    *SCENARIOS, *(pytest.param(name, marks=pytest.mark.soak) for name in LONG)])
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
        require(len(command.memory) == 1 or before.header == command.header,
                'a memory holds what acted')

    monkeypatch.setattr(processes, 'check_memory', check_memory)
    assert not SCENARIOS['with a reset'].search().broken  # and one fault
    assert SCENARIOS['with two faults'].search().broken == 'a memory holds what acted'


# -- the mutants ----------------------------------------------------------------------------


def takes_commands_of_others(active, sender, is_due):
    after, verdict = REAL['judge_command'](active, sender, is_due)
    return after, Verdict.ACTS if verdict is Verdict.IGNORED and is_due else verdict


def takes_commands_for_other_states(active, sender, is_due):
    return REAL['judge_command'](active, sender, True)


def takes_commands_for_other_runs(active, sender, is_due):
    return REAL['judge_command'](active, sender._replace(run=active.run), is_due)


def names_nobody(active, sender, is_due):
    return active, REAL['judge_command'](active, sender, is_due)[1]


def never_names_nobody(active, silent, command_timeout):
    return active


def names_nobody_at_once(active, silent, command_timeout):
    return REAL['after_silence'](active, command_timeout, command_timeout)


def resets_within_the_episode(active):
    return active


def does_not_hold_for_who_is_new(reached, since):
    return REAL['step_limit'](reached, 0)


def has_no_window(reached, since):
    return ENDLESS if REAL['step_limit'](reached, since) else 0


def holds_for_the_next_tick(reached, since):
    return min(reached, default=ENDLESS)


def answers_states_that_name_others(own_id, last, state, stamp, step, quiet):
    return REAL['judge_state'](own_id, last, state._replace(controller=''), stamp, step, quiet)


def answers_only_states_that_name_it(own_id, last, state, stamp, step, quiet):
    return REAL['judge_state'](
        own_id, last, state._replace(controller=state.controller or '?'), stamp, step, quiet)


def does_not_know_its_name(own_id, last, state, stamp, step, quiet):
    return REAL['judge_state']('', last, state, stamp, step, quiet)


def adopts_another_run_at_once(own_id, last, state, stamp, step, quiet):
    return REAL['judge_state'](own_id, last, state, stamp, step, RUN_TIMEOUT)


def never_adopts_another_run(own_id, last, state, stamp, step, quiet):
    return REAL['judge_state'](own_id, last, state, stamp, step, 0.0)


def does_not_repeat(own_id, last, state, stamp, step, quiet):
    last, reply = REAL['judge_state'](own_id, last, state, stamp, step, quiet)
    return last, Reply.STALE if reply is Reply.REPEAT else reply


def answers_anew_what_comes_again(own_id, last, state, stamp, step, quiet):
    last, reply = REAL['judge_state'](own_id, last, state, stamp, step, quiet)
    return last, Reply.ANSWER if reply is Reply.REPEAT else reply


def goes_back_in_time(own_id, last, state, stamp, step, quiet):
    if stamp < last.stamp:
        last = Answered(last.run, last.episode)
    return REAL['judge_state'](own_id, last, state, stamp, step, quiet)


def keeps_its_memory_over_a_reset(own_id, last, state, stamp, step, quiet):
    if state.run == last.run:
        last = last._replace(episode=state.episode)
    return REAL['judge_state'](own_id, last, state, stamp, step, quiet)


def keeps_its_memory_over_a_gap(own_id, last, state, stamp, step, quiet):
    return REAL['judge_state'](own_id, last, state, stamp, 0, quiet)


def keeps_its_memory_in_standby(own_id, last, state, stamp, step, quiet):
    after, reply = REAL['judge_state'](own_id, last, state, stamp, step, quiet)
    return last if reply is Reply.STAND_BY and last.run == after.run else after, reply


def never_keeps_its_memory(own_id, last, state, stamp, step, quiet):
    last, reply = REAL['judge_state'](own_id, last, state, stamp, step, quiet)
    return last, Reply.ANSWER_AFRESH if reply is Reply.ANSWER else reply


def names_nobody_while_it_holds(plant):
    return True


def lets_go_of_no_recorder(plant):
    return plant._replace(since=0, released=True)


def holds_for_no_recorder(plant):
    return plant


def joins_what_the_newest_copy_names(one):
    return one.named


def joins_whatever_is_there(one):
    return one.commands[0].header.author if one.commands else ''


MUTANTS = {
    (protocol, 'judge_command'): {
        takes_commands_of_others: ('beside a foreign controller', '5'),
        takes_commands_for_other_states: ('with two faults', '1'),
        takes_commands_for_other_runs: ('with two faults', '1'),
        names_nobody: ('without faults', '5'),
    },
    (protocol, 'after_silence'): {
        never_names_nobody: ('with two faults', '2'),
        names_nobody_at_once: ('without faults', '6'),
    },
    (protocol, 'after_reset'): {
        resets_within_the_episode: ('with a reset', '7'),
    },
    (protocol, 'step_limit'): {
        does_not_hold_for_who_is_new: ('with a recorder that is discovered late', '4'),
        has_no_window: ('with one controller and a recorder', '4'),
        holds_for_the_next_tick: ('with one controller and a recorder', '2'),
    },
    (protocol, 'judge_state'): {
        answers_states_that_name_others: ('without faults', '7'),
        answers_only_states_that_name_it: ('without faults', '2'),
        does_not_know_its_name: ('without faults', '7'),
        adopts_another_run_at_once: ('with two faults', '7'),
        never_adopts_another_run: ('with two faults', '2'),
        does_not_repeat: ('with two faults', '2'),
        answers_anew_what_comes_again: ('with two faults', '7'),
        goes_back_in_time: ('with messages out of order', '7'),
        keeps_its_memory_over_a_reset: ('with a reset', '7'),
        keeps_its_memory_over_a_gap: ('with three faults, longer', '7'),
        keeps_its_memory_in_standby: ('with two faults', '7'),
        never_keeps_its_memory: ('without faults', '7'),
    },
    (processes, 'names_anew'): {
        names_nobody_while_it_holds: ('with a recorder', '5'),
    },
    (processes, 'let_go'): {
        lets_go_of_no_recorder: ('with a recorder', '2'),
    },
    (processes, 'hold'): {
        holds_for_no_recorder: ('with a recorder that is discovered late', '4'),
    },
    (recorder, 'author_of_first'): {
        joins_what_the_newest_copy_names: ('with a recorder', '4'),
        joins_whatever_is_there: ('with a recorder that is discovered late', '4'),
    },
}


@pytest.mark.parametrize(('place', 'mutant', 'scenario', 'number'), [
    pytest.param(place, mutant, *caught, id=mutant.__name__.replace('_', ' '))
    for place, mutants in MUTANTS.items() for mutant, caught in mutants.items()])
def test_no_mutant_survives(monkeypatch, place, mutant, scenario, number):
    monkeypatch.setattr(*place, mutant)
    found = (SCENARIOS | ENDLESS_SEARCH)[scenario].search()
    assert found.broken[:1] == number, '\n'.join([found.broken, *found.trace])


# -- the nodes ------------------------------------------------------------------------------


def test_the_arbiters_and_the_joiner_do_on_random_walks_what_the_model_does():
    for seed in range(200):
        random, nodes = Random(seed), Nodes()
        bound = Bound(faults=4, copies=3, resets=1, unheard=2)
        world = random.choice([*start(BOTH, 'R1', bound)])
        for _ in range(60):
            found = [*moves(world)]
            likely = [move for move in found if move[1].bound.faults == world.bound.faults]
            what, after = random.choice(likely if random.random() < 0.8 else found)
            nodes.follow(what, world, after)
            world = after
