"""
Flow control by the recorders: how far simulated time may advance.

A recorder publishes on recorder_progress the stamp up to which its samples are complete. DDS
alone would drop messages (keep last) or fail to publish them (keep all), without telling the
sender.
"""

from impulse_control_ros.core.protocol import ENDLESS, step_limit
from impulse_control_ros.core.silence import Silence
from impulse_control_ros.core.tick import SampleClock, SECOND

LEAVES = 2**31 - 1  # s; progress that announces the end of a recorder


class RecorderFlowControl:
    """
    Tracks the recorders that have joined a plant with the sample clock ``clock``.

    The plant may leave the ticks below ``limit``. Without ``lockstep``, recorders never hold the
    plant.
    """

    def __init__(self, clock: SampleClock, lockstep: bool) -> None:
        self.limit = ENDLESS
        self._clock, self._lockstep = clock, lockstep
        self._reached: dict[str, int] = {}
        self._silences: dict[str, Silence] = {}
        self._since = 0

    def __len__(self) -> int:
        return len(self._reached)

    def take(self, recorder: str, stamp_ns: int, now: float) -> str:
        """Take the progress of a recorder, received ``now`` [s]; return a text for the log."""
        if stamp_ns >= LEAVES * SECOND:
            return 'has ended' if self._drop(recorder) else ''
        news = '' if recorder in self._reached else 'has joined'
        self._silences[recorder] = Silence(now)
        if news:
            self._reached[recorder] = self._clock.tick - 1
            self.hold()
        if stamp_ns:
            told = min(self._clock.tick_at(stamp_ns), self._clock.tick)
            self._reached[recorder] = max(self._reached[recorder], told)
        self._update()
        return news

    def drop_silent(self, now: float, timeout: float) -> list[str]:
        """Drop the recorders that have been silent for ``timeout`` [s]; return their ids."""
        return [
            recorder
            for recorder, silence in list(self._silences.items())
            if silence.look(now) > timeout and self._drop(recorder)
        ]

    def _drop(self, recorder: str) -> bool:
        known = self._reached.pop(recorder, None) is not None
        self._silences.pop(recorder, None)
        self._update()
        return known

    def hold(self) -> None:
        """Hold the plant until every recorder has the present sample: an endpoint may be new."""
        self._since = max(0, self._clock.tick)
        self._update()

    def let_go(self) -> None:
        """Stop waiting for missing messages up to the present tick; they will not arrive."""
        for recorder, reached in self._reached.items():
            self._reached[recorder] = max(reached, self._clock.tick)
        self._update()

    def _update(self) -> None:
        if self._lockstep:
            self.limit = step_limit(self._reached.values(), self._since)

    @property
    def may_step(self) -> bool:
        """Whether the plant may leave the present state."""
        return self._clock.tick < self.limit

    @property
    def have_last(self) -> bool:
        """Whether every recorder has the present sample."""
        return not self._lockstep or all(one >= self._clock.tick for one in self._reached.values())
