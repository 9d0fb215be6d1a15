"""
Ctrl-C is taken from the first moment, before the long imports.

Signals only set a flag, any number of times; whoever loops looks at it.
"""

import signal
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Set by SIGINT and SIGTERM."""

    def __init__(self) -> None:
        self.requested = False
        for number in SIGNALS:
            signal.signal(number, self._request)

    def _request(self, *_: Any) -> None:
        self.requested = True

    def ignore(self) -> None:
        """Take no signal from now on: the interpreter puts the default handlers back on exit."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
