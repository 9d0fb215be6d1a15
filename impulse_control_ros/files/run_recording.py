"""Record one run: its sample joiner, and its bag from the first sample on."""

from collections.abc import Callable, Sequence
from time import monotonic

from impulse_control_ros.core.protocol import RUN_TIMEOUT
from impulse_control_ros.core.silence import Silence
from impulse_control_ros.files.bag import BagWriter, describe_run, Topic
from impulse_control_ros.files.sample_joiner import RecordedPlant, SampleJoiner

# s to wait for a missing message: DDS resends it within 3 s if its author is alive; a replaced
# author is dead, or its message comes too late
GIVE_UP, GIVE_UP_REPLACED = 5.0, 1.0


class RunRecording:
    """
    Records the run of ``plant`` into the bag that ``make_bag`` creates.

    ``run`` is the id of the run. ``bag`` is None until a state and a command have arrived.
    ``described`` returns the topics from a given number on.
    """

    def __init__(
        self,
        plant: RecordedPlant,
        make_bag: Callable[[], BagWriter],
        described: Callable[[int], Sequence[Topic]],
    ) -> None:
        self.run, self.joiner = plant.run, SampleJoiner(plant)
        self.bag: BagWriter | None = None
        self._make_bag, self._described = make_bag, described
        self._topics = 0
        self._began_at = self._wrote_at = 0.0
        self._heard = self._reached = 0
        self._quiet, self._stuck = Silence(monotonic()), Silence(monotonic())

    def write(self, everything: bool = False) -> None:
        """Write the complete samples, or ``everything``, into the bag."""
        joiner = self.joiner
        if not joiner.begun:
            joiner.forget_early_states()
            return
        if self.bag is None:
            self.bag = self._make_bag()
            self._began_at = monotonic()
        entries = joiner.take(everything)
        if not entries:
            return
        self._wrote_at = monotonic()
        if self._topics == 0 or max(channel for _, channel, _ in entries) > self._topics:
            self._add_topics()
        self.bag.write(entries)

    def _add_topics(self) -> None:
        assert self.bag
        topics = self._described(self._topics)
        if not self._topics:
            describe_run(self.bag, self.run, topics)
        for topic in topics:
            self.bag.add_topic(topic)
        self._topics += len(topics)

    def look(self) -> None:
        """Measure the time without a state of the run, and without a new complete sample."""
        joiner, now = self.joiner, monotonic()
        if joiner.heard != self._heard:
            self._heard, joiner.other = joiner.heard, None
            self._quiet.hear()
        if joiner.reached != self._reached or not joiner.is_blocked:
            self._reached = joiner.reached
            self._stuck.hear()
        self._quiet.look(now)
        if self._stuck.look(now) > (GIVE_UP_REPLACED if joiner.is_replaced else GIVE_UP):
            joiner.give_up()

    @property
    def is_quiet(self) -> bool:
        """Whether no state of the run has arrived for `RUN_TIMEOUT`."""
        return self._quiet.seconds > RUN_TIMEOUT

    def finish(self) -> str:
        """Finish the bag with everything received; return a summary, '' without a bag."""
        self.write(everything=True)
        if self.bag is None:
            return ''
        self._add_topics()  # the topics without messages
        counts = {
            name: str(value) for name, value in self.joiner.counts.items() if name != 'states'
        }
        self.bag.close({**counts, 'wall_seconds': f'{self._wrote_at - self._began_at:.6f}'})
        return (
            f'{self.bag.folder}: {self.bag.count} messages written, {counts["missing"]} '
            f'missing, {counts["repeated"]} repeats dropped'
        )
