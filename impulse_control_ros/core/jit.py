"""Compilation of the laws, and calls without numba's dispatch."""

from collections.abc import Callable
from typing import Any

import numba

# Nodes, simulate() and batches inline one law and compute the same bits: without fastmath no
# compiled copy reorders or contracts its arithmetic. A division by zero gives inf; a test for an
# exception would keep LLVM from computing several runs at once.
compiled = numba.njit(cache=True, error_model='numpy', nogil=True, forceinline=True)


@compiled
def sign(value: float) -> float:
    """Return -1, 0 or 1."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


def machine_code(kernel: Any, *arguments: Any) -> Callable[..., None]:
    """
    Compile ``kernel`` for the types of ``arguments`` and return the compiled function itself.

    numba's dispatcher checks the type of each argument at each call, which for record arrays costs
    more than the kernel: 0.6 us against 0.2 us. The caller is responsible for the types. The
    kernel runs once and may overwrite ``arguments``.
    """
    kernel(*arguments)
    code: Callable[..., None] = kernel.overloads[kernel.signatures[-1]].entry_point
    return code
