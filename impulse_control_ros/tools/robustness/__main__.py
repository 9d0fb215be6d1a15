"""Renew docs/robustness.md: ``python -m impulse_control_ros.tools.robustness docs``."""

import sys

from impulse_control_ros.stop import StopRequest
from impulse_control_ros.tools.robustness.command import main

if __name__ == '__main__':
    sys.exit(main(StopRequest(patience=1)))
