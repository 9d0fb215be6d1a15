"""
The protocol between the plant, its controllers and its recorders.

Every message has its run and author in ``header.frame_id``, otherwise unused in JointState:

=====================  ====================================  ===================================
message                frame_id                              meaning
=====================  ====================================  ===================================
joint_states           run:NNNNNNNN.E CONTROLLER             the active one, absent if none
joint_commands         run:NNNNNNNN.E AUTHOR GUARD VERDICT   see below
impulse_events         run:NNNNNNNN.E AUTHOR GUARD VERDICT
recorder_progress      run:NNNNNNNN RECORDER
run_parameters (node)  run:NNNNNNNN NODE                     NODE: plant name or controller id
=====================  ====================================  ===================================

GUARD: the one that fired. VERDICT: that of the supervision on an earlier impulse. Both are absent
if there is none; ``-`` stands for no guard before a verdict. A sample with either has an event.
NNNNNNNN: 8 random hexadecimal digits, new at each start of a plant. E: the episode, 0 at the
start and incremented at each reset. An id is a node's full name, ``#`` and 4 random digits, new
at each start. Any other frame_id belongs to a foreign peer, such as a robot driver.

1. The plant selects the active controller. While its states name none, every controller may
   answer. The author of the first command with the right stamp becomes active; the next state
   names it. Commands of others are ignored. An unanswered state is soon republished. When the
   active controller has been silent for ``command_timeout``, the plant republishes the state
   without a name.
2. A controller answers states that name it or no controller, and stands by otherwise. It answers
   a republished state with the same bytes. A new run or episode clears its memory.
3. A controller keeps its run while it receives states of it. It ignores states of another run,
   and adopts that run after `RUN_TIMEOUT` without a state of its own.
4. A controller always answers a foreign plant, with only GUARD VERDICT as frame_id. The plant
   takes the commands of a foreign controller by rule 1, and its states then name `FOREIGN`. A
   foreign manager may wait for time to pass, and stamp by another clock: after ``command_timeout``
   without a command, while /clock is read and no controller of ours is there, a plant in lockstep
   makes a sample with the effort held, and then takes foreign commands with later stamps as well.
5. A recorder joins when it publishes its progress, and is dropped after ``recorder_timeout``
   without any. The plant stays at most `WINDOW` samples ahead of the slowest. When a recorder
   joins or a controller becomes active, the plant republishes its state until every recorder
   has the complete sample.
6. Parameters are published on run_parameters before the state at which they take effect. A
   controller answers one of our plants only once it has that plant's parameters.

The decisions are pure functions: test/core/test_protocol.py searches their interleavings.
"""

from collections.abc import Iterable
from enum import auto, Enum
import re
import secrets
from typing import NamedTuple

FOREIGN = NO_GUARD = '-'
RUN_TIMEOUT = 1.0  # s
WINDOW = 1000  # samples
ENDLESS = 2**62
_STATE = re.compile(r'run:([0-9a-f]{8})\.(\d{1,9})(?: (\S+))?')
_COMMAND = re.compile(r'run:([0-9a-f]{8})\.(\d{1,9}) (\S+)(?: (\S+))?(?: (\S+))?')
_FOREIGN_COMMAND = re.compile(r'(\S+) (\S+)')
_NODE = re.compile(r'(?:run:([0-9a-f]{8}) )?(\S+)')


class StateHeader(NamedTuple):
    """The frame_id of a state; ``run`` is '' for a foreign plant, ``controller`` '' if none."""

    run: str = ''
    episode: int = 0
    controller: str = ''

    @property
    def frame_id(self) -> str:
        """The frame_id; '' for a foreign plant."""
        if not self.run:
            return ''
        return f'run:{self.run}.{self.episode}' + (f' {self.controller}' * bool(self.controller))


class CommandHeader(NamedTuple):
    """
    The frame_id of a command or an event.

    ``guard`` and ``verdict`` are '' if there is none. ``run`` is '' if the plant or the controller
    is foreign; a parsed ``author`` is then `FOREIGN`, and ``guard`` the whole frame_id, unless it
    has two words.
    """

    run: str = ''
    episode: int = 0
    author: str = FOREIGN
    guard: str = ''
    verdict: str = ''

    @property
    def frame_id(self) -> str:
        """The frame_id; guard and verdict alone without a run."""
        what = f'{self.guard or NO_GUARD} {self.verdict}' if self.verdict else self.guard
        if not self.run:
            return what
        return f'run:{self.run}.{self.episode} {self.author}' + f' {what}' * bool(what)

    @property
    def has_event(self) -> bool:
        """Whether an event belongs to the command."""
        return bool(self.guard or self.verdict)


class NodeHeader(NamedTuple):
    """The author of progress or parameters; ``run`` is '' with a foreign plant."""

    run: str
    node: str

    @property
    def frame_id(self) -> str:
        """The text in the message."""
        return f'run:{self.run} {self.node}' if self.run else self.node


def parse_state(frame_id: str) -> StateHeader:
    """Parse the frame_id of a state."""
    found = _STATE.fullmatch(frame_id)
    return StateHeader(found[1], int(found[2]), found[3] or '') if found else StateHeader()


def parse_command(frame_id: str) -> CommandHeader:
    """Parse the frame_id of a command or an event."""
    found = _COMMAND.fullmatch(frame_id)
    if found:
        return CommandHeader(found[1], int(found[2]), found[3], guard_in(found[4]), found[5] or '')
    words = _FOREIGN_COMMAND.fullmatch(frame_id)
    return CommandHeader(
        guard=guard_in(words[1]) if words else frame_id, verdict=words[2] if words else ''
    )


def guard_in(word: str | None) -> str:
    """Return the guard that a word of a frame_id stands for; '' for none."""
    return '' if word in (None, NO_GUARD) else str(word)


def parse_node(frame_id: str) -> NodeHeader:
    """Parse the frame_id of progress or the node of parameters; both parts are '' if invalid."""
    found = _NODE.fullmatch(frame_id)
    return NodeHeader(found[1] or '', found[2]) if found else NodeHeader('', '')


def new_run() -> str:
    """Return a random id for a run."""
    return secrets.token_hex(4)


def new_id(full_name: str) -> str:
    """Return a random id for a node."""
    return f'{full_name}#{secrets.token_hex(2)}'


def name_of(node_id: str) -> str:
    """Return the full name of the node with this id."""
    return node_id.partition('#')[0]


# -- the plant's decisions ------------------------------------------------------------------


class Verdict(Enum):
    """The plant's decision on a command."""

    ACTS = auto()
    STALE = auto()  # not the expected stamp
    IGNORED = auto()  # another controller is active
    OTHER_RUN = auto()
    OLD = auto()  # without lockstep: older than max_age


def judge_command(
    active: StateHeader, sender: CommandHeader, is_due: bool
) -> tuple[StateHeader, Verdict]:
    """
    Decide on a command while the plant's states have the header ``active``.

    ``is_due``: its stamp is the expected one. Returns the next state's header and the verdict.
    """
    ours = sender.run == active.run and sender.episode == active.episode
    if not ours and sender.author != FOREIGN:
        return active, Verdict.OTHER_RUN
    if active.controller and active.controller != sender.author:
        return active, Verdict.IGNORED
    if not is_due:
        return active, Verdict.STALE
    if not active.controller:
        active = active._replace(controller=sender.author)
    return active, Verdict.ACTS


def after_silence(active: StateHeader, silent: float, command_timeout: float) -> StateHeader:
    """Return the header with which an unanswered state is republished."""
    return active._replace(controller='') if silent >= command_timeout else active


def after_reset(active: StateHeader) -> StateHeader:
    """Return the header of the first state of the next episode."""
    return active._replace(episode=active.episode + 1)


def step_limit(reached: Iterable[int], since: int) -> int:
    """
    Return the first tick that the recorders do not let the plant leave.

    ``reached`` has the last complete tick of each recorder. All must have reached ``since``, the
    tick at which the last recorder joined or the last controller became active: new endpoints may
    not be matched yet.
    """
    slowest = min(reached, default=ENDLESS)
    return slowest + WINDOW if slowest >= since else 0


# -- a controller's decisions ---------------------------------------------------------------


class Reply(Enum):
    """A controller's decision on a state."""

    ANSWER = auto()
    ANSWER_AFRESH = auto()  # with an empty memory
    REPEAT = auto()  # send the same bytes again
    STAND_BY = auto()
    STALE = auto()  # older than the last one answered
    OTHER_RUN = auto()


class Answered(NamedTuple):
    """
    The last state a controller answered: run (None before the first), episode and stamp [ns].

    ``stamp`` is 0 if the next answer starts with an empty memory.
    """

    run: str | None = None
    episode: int = 0
    stamp: int = 0


def judge_state(
    own_id: str, last: Answered, state: StateHeader, stamp: int, step: int, quiet: float
) -> tuple[Answered, Reply]:
    """
    Decide on a state of one of our plants at ``stamp`` [ns].

    ``step`` [ns] is the time between states in lockstep, 0 if arbitrary; ``quiet`` [s] is the
    wall time since the last state of the controller's run.
    """
    if state.run != last.run:
        if last.run is not None and quiet < RUN_TIMEOUT:
            return last, Reply.OTHER_RUN
        last = Answered(state.run, state.episode)
    if state.episode < last.episode or stamp < last.stamp:
        return last, Reply.STALE
    if state.controller not in ('', own_id):
        return Answered(state.run, state.episode), Reply.STAND_BY
    if stamp == last.stamp:
        return last, Reply.REPEAT
    follows = last.stamp and state.episode == last.episode and step in (0, stamp - last.stamp)
    return (
        Answered(state.run, state.episode, stamp),
        Reply.ANSWER if follows else Reply.ANSWER_AFRESH,
    )


def judge_foreign_state(last: Answered, stamp: int, quiet: float) -> tuple[Answered, Reply]:
    """Decide on a state of a foreign plant, like `judge_state`; its time may go back."""
    if last.run != '':
        if last.run is not None and quiet < RUN_TIMEOUT:
            return last, Reply.OTHER_RUN
        last = Answered('')
    if stamp == last.stamp:
        return last, Reply.REPEAT
    follows = last.stamp and stamp > last.stamp
    return last._replace(stamp=stamp), Reply.ANSWER if follows else Reply.ANSWER_AFRESH
