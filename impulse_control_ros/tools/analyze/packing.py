"""
Arrays in a page: base64 of deflated bytes, undone by unpacked() of page/samples.js.

Each value is 32 bits wide. The difference from the value before it, in two's complement of the
bits, is small where the values are smooth; the first bytes of all differences, then the second
ones and so on, deflate far better than value by value.
"""

from base64 import b64encode
import zlib

import numpy as np

LEVEL = 6  # 9 takes three times as long, for a percent


def packed(values: np.ndarray) -> str:
    """Return ``values`` of shape (n,): floats to single precision, or integers below 2^32."""
    kind = '<f4' if values.dtype.kind == 'f' else '<u4'
    bits = values.astype(kind).view('<u4')
    steps = np.diff(bits, prepend=np.uint32(0))  # modulo 2^32
    return deflated(steps.astype('<u4').view(np.uint8).reshape(-1, 4).T.tobytes())


def deflated(content: bytes) -> str:
    """Return the text of ``content``."""
    return b64encode(zlib.compress(content, LEVEL)).decode()


def on_grid(time: np.ndarray) -> tuple[np.ndarray, int]:
    """
    Return integers below 2^32 and their unit [ns], for ``time`` [ns] from 0, shape (n,).

    The unit is the greatest common divisor, so nothing is rounded unless a run of more than 4 s
    has no step; then to its 2^32th part.
    """
    unit = int(np.gcd.reduce(time)) or 1
    unit = max(unit, -(-int(time[-1]) // (2**32 - 1)))
    return time // unit, unit
