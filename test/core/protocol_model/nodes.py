"""What the nodes and the recorder are built of, led through the moves of the model."""

from impulse_control_ros.core.command_arbiter import CommandArbiter
from impulse_control_ros.core.protocol import parse_command, Reply, RUN_TIMEOUT, Verdict
from impulse_control_ros.core.state_arbiter import StateArbiter
from impulse_control_ros.files.cdr import COMMANDED, FIELDS, JointStateLayout, read_header
from impulse_control_ros.files.sample_joiner import COMMANDS, RecordedPlant, SampleJoiner, STATES


def encoded(message, stamp, fields=FIELDS):
    layout = JointStateLayout('axis', message.header.frame_id, fields)
    return layout.encode(0, stamp, *[0.0] * len(fields))


class Nodes:
    """The arbiters and the joiner that take the messages of one walk through the model."""

    def __init__(self):
        self.states, self.headers = {}, {}
        self.recorder, self.joiner = '', None
        self.acted = {}  # the author whose command acted, by run and stamp

    def follow(self, what, before, after):
        """Take what is taken in a move, and decide as the model does."""
        if after.acted and after.acted[-1:] != before.acted[-1:]:
            last = after.acted[-1]
            self.acted[last.run, last.stamp] = last.header.author
        if what[0] == 'plant gets':
            self.take_command(what[1], before, after)
        elif what[0] in ('recorder polls', 'recorder gives up'):
            self.join(before, after.recorder)
        elif what[1:2] == ('gets',):
            self.take_state(what, before, after)

    def take_command(self, command, before, after):
        plant = before.plant
        arbiter = CommandArbiter(plant.header.run, True, 0.0)
        arbiter.expect((0, plant.tick + 1), 0.0)
        arbiter.header, arbiter.awaiting = plant.header, plant.awaits
        verdict = arbiter.take(command.header, (0, command.stamp), 0.0, 0.0)
        assert (verdict is Verdict.ACTS) == (after.acted[-1:] != before.acted[-1:])
        assert arbiter.header.controller == after.plant.header.controller

    def take_state(self, what, before, after):
        name, _, state, *silence = what
        at = [one.id for one in before.controllers].index(name)
        one, stamp = after.controllers[at], state.tick + 1
        arbiter = self.states.setdefault(name, StateArbiter(name, 1, 0.0))
        if silence:
            arbiter.silence.seconds = RUN_TIMEOUT
        # a reader of messages returns the same header for the same frame_id
        header = self.headers.setdefault(state.header.frame_id, state.header)
        reply = (
            Reply.ANSWER if arbiter.follows(header, stamp) else arbiter.judge(header, stamp, True)
        )
        assert (arbiter.run, arbiter.stamp) == (one.last.run, one.last.stamp)
        if one.sent is before.controllers[at].sent:
            assert reply not in (Reply.ANSWER, Reply.ANSWER_AFRESH)
        else:
            assert reply is (Reply.ANSWER if one.sent.memory[1:] else Reply.ANSWER_AFRESH)

    def join(self, before, recorder):
        """Give the joiner what the recorder takes, or let it give up where there is nothing."""
        if recorder.id != self.recorder:
            self.recorder, self.joiner = recorder.id, None
        messages = [
            *((STATES, encoded(one, one.tick + 1)) for one in before.recorded_states),
            *((COMMANDS, encoded(one, one.stamp, COMMANDED)) for one in before.recorded_commands),
        ]
        if self.joiner:
            self.take_samples(messages)
        if not self.joiner or self.joiner.plant.run != recorder.run:
            self.joiner = SampleJoiner(RecordedPlant(recorder.run, 'axis', 1, True))
            self.take_samples(messages)
        assert self.joiner.reached - 1 == recorder.reached

    def take_samples(self, messages):
        """Check of each sample that is handed out that its command is the one that acted."""
        for channel, raw in messages:
            self.joiner.add(channel, raw, 0)
        if not messages:
            self.joiner.give_up()
        for stamp, channel, raw in self.joiner.take() if self.joiner.begun else ():
            if channel == COMMANDS:
                author = parse_command(read_header(raw)[1].decode()).author
                assert author == self.acted[self.joiner.plant.run, stamp]
