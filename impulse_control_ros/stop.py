"""
Ctrl-C is taken from the first moment, before the long imports.

Signals only set a flag, any number of times; whoever loops looks at it. What may be left at any
moment can let more of them end it at once.
"""

import math
import os
import signal
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Set by SIGINT and SIGTERM; the process ends at more of them than ``patience``."""

    def __init__(self, patience: float = math.inf) -> None:
        self.requested = False
        self._patience = patience
        for number in SIGNALS:
            signal.signal(number, self._request)

    def _request(self, *_: Any) -> None:
        self.requested = True
        self._patience -= 1
        if self._patience < 0:
            os.write(2, b'interrupted\n')
            os._exit(1)

    def ignore(self) -> None:
        """Take no signal from now on: the interpreter puts the default handlers back on exit."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
