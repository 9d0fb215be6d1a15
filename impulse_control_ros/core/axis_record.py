"""
Records of an axis, made ready for identification: uniform samples and their noise.

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
dt          time_step       s        sampling period
q           encoder_step    m        step of the encoder
s_x, s_v    ..._noise       m, m/s   standard deviations of the noise of position and velocity
==========  ==============  =======  ==========================================================
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impulse_control_ros.core.identification import Record
from impulse_control_ros.core.parameter import refusal

AFTER = 'after'  # its time, an effort is held
LEAST_SAMPLES = 50
JITTER = 0.02  # of a sample: larger deviations from uniform times call for resampling
GAP = 3.5  # samples: a longer step of the time divides a record
MOST_STEPS = 1e5  # of the encoder in one sample
CHUNK = 64  # samples of one estimate of the noise
LAG_SMOOTHING = 0.02  # s
FAST = 0.1  # of the largest speed
REST = 0.01  # of the rms velocity: a slower axis counts as standing


@dataclass(frozen=True, kw_only=True)
class Samples:
    """
    A piece of a record with uniform samples.

    ``position`` [m] (minus its mean), ``effort`` [N] and ``velocity`` [m/s] or None have shape
    (n,); ``start`` [s] is the time of the first sample. ``index`` and ``name`` are those of its
    record. ``jitter`` [s] is how far the times were from uniform steps, 0 if not resampled.
    ``is_exact`` says that the sign of the velocity can be trusted at each sample.
    """

    index: int
    name: str
    start: float
    time_step: float
    position: np.ndarray
    effort: np.ndarray
    velocity: np.ndarray | None
    encoder_step: float
    position_noise: float
    velocity_noise: float
    is_exact: bool
    jitter: float

    @property
    def variance(self) -> float:
        """Variance [m^2] of the measured position: noise and quantisation."""
        return float(self.position_noise**2 + self.encoder_step**2 / 12.0)


def record_of(source: Any, name: str = 'record') -> Record:
    """
    Return a `Record` of a trajectory, or of a frame or mapping with named columns.

    Of a `Run`, the record has what the controller saw; of a `Recording`, states that no command
    answers are left out. The effort of both is a command, held until the next one. Raises
    `ParameterError` for a missing column, lengths that differ, values that are not finite and
    times that do not increase.
    """
    held = None
    if isinstance(source, Record):
        columns: dict[str, Any] = {
            key: getattr(source, key) for key in ('time', 'position', 'effort', 'velocity')
        }
        name, held = source.name, source.effort_held
    elif isinstance(source, Mapping) or hasattr(source, 'columns'):
        columns = {key: source.get(key) for key in ('position', 'effort', 'velocity')}
        columns['time'] = source['time'] if 'time' in source else getattr(source, 'index', None)
    else:
        held = AFTER
        columns = {
            key: getattr(source, f'measured_{key}', getattr(source, key, None))
            for key in ('time', 'position', 'effort', 'velocity')
        }
        if columns['effort'] is not None:
            answered = np.isfinite(columns['effort'])
            columns = {
                key: None if column is None else np.asarray(column)[answered]
                for key, column in columns.items()
            }
    arrays = {
        key: None if value is None else np.asarray(value, float) for key, value in columns.items()
    }
    speed = arrays['velocity']
    if speed is not None and not np.isfinite(speed).all():
        arrays['velocity'] = None  # a driver that measures none
    checked = {key: _checked(name, key, arrays) for key in ('time', 'position', 'effort')}
    if not np.all(np.diff(checked['time']) > 0.0):
        at = int(np.argmin(np.diff(checked['time']) > 0.0)) + 1
        raise refusal(
            f'{name}: time[{at}]', float(checked['time'][at]), 'later than the one before'
        )
    return Record(**checked, velocity=arrays['velocity'], effort_held=held, name=name)


def _checked(name: str, key: str, arrays: Mapping[str, np.ndarray | None]) -> np.ndarray:
    """Return one column of a record, or raise `ParameterError`."""
    values, time = arrays[key], arrays['time']
    if values is None:
        raise refusal(f'{name}: {key}', None, 'a column of numbers')
    if values.ndim != 1 or time is None or len(values) != len(time):
        raise refusal(f'{name}: shape of {key}', values.shape, 'that of time, (n,)')
    if len(values) < LEAST_SAMPLES:
        raise refusal(f'{name}: number of samples', len(values), f'>= {LEAST_SAMPLES}')
    if not np.isfinite(values).all():
        at = int(np.argmin(np.isfinite(values)))
        raise refusal(f'{name}: {key}[{at}]', float(values[at]), 'finite')
    return values


def samples_of(record: Record, index: int, effort_scale: float) -> list[Samples]:
    """Return the pieces of a record between gaps of its times, each with uniform samples."""
    steps = np.diff(record.time)
    middle = float(np.median(steps))
    step = encoder_step(record.position)
    edges = [0, *(np.flatnonzero(steps > GAP * middle) + 1).tolist(), len(record.time)]
    pieces = []
    for first, last in zip(edges, edges[1:], strict=False):
        if last - first >= LEAST_SAMPLES:
            part = slice(first, last)
            pieces.append(_uniform(record, part, index, step, effort_scale))
    return pieces


def _uniform(record: Record, part: slice, index: int, step: float, effort_scale: float) -> Samples:
    time, position, effort = record.time[part], record.position[part], record.effort[part]
    velocity = None if record.velocity is None else record.velocity[part]
    time_step = float((time[-1] - time[0]) / (len(time) - 1))
    even = time[0] + np.arange(len(time)) * time_step
    jitter = float(np.max(np.abs(np.diff(time) - time_step)))
    if jitter <= JITTER * time_step:
        jitter = 0.0
    else:
        position, effort = np.interp(even, time, position), np.interp(even, time, effort)
        velocity = None if velocity is None else np.interp(even, time, velocity)
    plain = Samples(
        index=index,
        name=record.name,
        start=float(time[0]),
        time_step=time_step,
        position=position - position.mean(),
        effort=effort * effort_scale,
        velocity=velocity,
        encoder_step=step,
        position_noise=0.0,
        velocity_noise=np.nan,
        is_exact=False,
        jitter=jitter,
    )
    return _with_noise(plain)


def encoder_step(position: np.ndarray) -> float:
    """Return the step [m] of the position: all its changes are multiples of it; 0 for none."""
    change = np.abs(np.diff(position))
    # changes of the change are small where the axis is always fast
    small = np.concatenate([change, np.abs(np.diff(change))])
    small = small[small > 1e-9 * float(np.ptp(position))]
    if not len(small) or change.max() > MOST_STEPS * small.min():
        return 0.0
    least = float(small.min())
    for divisor in (1, 2, 3):
        multiple = change * (divisor / least)
        whole = np.round(multiple)
        if np.mean(np.abs(multiple - whole) < 0.02) > 0.99:
            # the mean over all changes, for the least one has rounding errors
            return float(change.sum() / whole.sum())
    return 0.0


def _with_noise(samples: Samples) -> Samples:
    """Return the samples with the noise of position and velocity, at rest where there is rest."""
    drift = _drift(samples.position)
    still = drift <= REST * np.sqrt(np.mean(drift**2))
    position = _chunk_variance(samples.position, still) - samples.encoder_step**2 / 12.0
    at_rest, exact = np.nan, False
    if samples.velocity is not None:
        at_rest = float(np.sqrt(_chunk_variance(samples.velocity, still)))
        exact = _is_exact(samples, drift > FAST * drift.max())
    return replace(
        samples,
        position_noise=float(np.sqrt(max(position, 0.0))),
        velocity_noise=at_rest,
        is_exact=exact,
    )


def _is_exact(samples: Samples, fast: np.ndarray) -> bool:
    """Return whether the measured velocity shows its sign at each sample: no noise, no lag."""
    assert samples.velocity is not None
    length = max(round(LAG_SMOOTHING / samples.time_step / 3.0), 1)
    speed = derivative(smooth(samples.position, length), samples.time_step)
    late = np.abs(smooth(samples.velocity, length) - speed)
    moving = np.abs(speed) > FAST * np.abs(speed).max()
    typical = float(np.median(np.abs(speed[moving]))) if moving.any() else 0.0
    noise = float(np.sqrt(_chunk_variance(samples.velocity, fast)))
    return noise < 1e-3 * typical and float(np.median(late[moving])) < 1e-2 * typical


def _chunk_variance(signal: np.ndarray, some: np.ndarray) -> float:
    """Return the variance of white noise on a smooth signal: its fourth difference, over 70."""
    chunks = _chunks(signal)
    fourth = np.diff(chunks, 4, axis=1)
    return float(np.median((fourth[some] if some.any() else fourth).var(axis=1)) / 70.0)


def _chunks(signal: np.ndarray) -> np.ndarray:
    size = min(CHUNK, len(signal))
    count = len(signal) // size
    return signal[: count * size].reshape(count, size)


def _drift(position: np.ndarray) -> np.ndarray:
    """Return how far [m] the axis moves in half of each chunk, shape (k,)."""
    chunks = _chunks(position)
    half = chunks.shape[1] // 2
    return np.asarray(np.abs(chunks[:, half:].mean(axis=1) - chunks[:, :half].mean(axis=1)))


def smooth(signal: np.ndarray, length: int) -> np.ndarray:
    """Return a signal smoothed by three boxes of ``length`` samples (made odd), without delay."""
    half = length // 2
    if half == 0:
        return signal
    for _ in range(3):
        ends = 2.0 * signal[0] - signal[half:0:-1], 2.0 * signal[-1] - signal[-2 : -half - 2 : -1]
        padded = np.concatenate([[0.0], ends[0], signal, ends[1]])
        padded.cumsum(out=padded)
        signal = padded[2 * half + 1 :] - padded[: -2 * half - 1]
        signal /= 2 * half + 1
    return signal


def derivative(signal: np.ndarray, time_step: float) -> np.ndarray:
    """Return the derivative of a signal by central differences."""
    return np.asarray(np.gradient(signal, time_step))
