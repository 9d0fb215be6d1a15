"""
The decisions with a rule left out or replaced, and what the search finds of them.

Each mutant stands with the scenario in which it breaks a property, and the property's number, both
of test_protocol.py. The last ones are of what the plant's node and the joiner make of the rules.
"""

from impulse_control_ros.core import protocol
from impulse_control_ros.core.protocol import Answered, ENDLESS, Reply, RUN_TIMEOUT, Verdict
from test.core.protocol_model import processes, recorder

REAL = {
    name: getattr(protocol, name)
    for name in ('judge_command', 'judge_state', 'after_silence', 'step_limit')
}


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
        own_id, last, state._replace(controller=state.controller or '?'), stamp, step, quiet
    )


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
