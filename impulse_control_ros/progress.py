"""The progress of simulated time, on a terminal."""

from typing import Any

from tqdm import tqdm


def simulated_time(duration: float) -> Any:
    """Return a bar up to ``duration`` [s], which is drawn on a terminal only."""
    tqdm.monitor_interval = 0  # no thread beside ours
    return tqdm(
        total=duration,
        unit='s',
        disable=None,
        leave=False,
        bar_format='{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated, {rate_fmt}',
    )
