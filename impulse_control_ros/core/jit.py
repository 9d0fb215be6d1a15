"""How kernels are compiled, and called without numba's dispatch."""

from collections.abc import Callable, Sequence
from typing import Any

import numba
from numba.np.unsafe.ndarray import to_fixed_tuple as to_fixed_tuple
import numpy as np

from impulse_control_ros.kernel_cache import KernelCache

INTERPRETED = bool(numba.config.DISABLE_JIT)  # the kernels run in Python


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function with these options of numba."""

    def decorate(function: Callable[..., Any]) -> Any:
        if INTERPRETED:
            return np.errstate(all='ignore')(function)
        made: Any = numba.njit(**options)(function)
        made._cache = KernelCache(function)  # as numba's enable_caching does
        return made

    return decorate


# One law serves the nodes, simulate() and batches, inlined into each, to the same bits: without
# fastmath no compiled copy reorders or contracts its arithmetic. A division by zero gives inf,
# not an exception, whose test would keep LLVM from computing several runs at once.
compiled = kernel(error_model='numpy', nogil=True, forceinline=True)


def first_values(values: np.ndarray, size: int) -> tuple[Any, ...]:
    """Replace numba's to_fixed_tuple, which exists in compiled code only."""
    return tuple(values[:size])


if INTERPRETED:
    to_fixed_tuple = first_values


def record(fields: Sequence[Any]) -> np.dtype:
    """Return the dtype of a record whose fields are attributes, in Python as in a kernel."""
    return np.dtype((np.record, fields))


@compiled
def sign(value: float) -> float:
    """Return -1, 0 or 1."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


def machine_code(function: Any, *arguments: Any) -> Callable[..., None]:
    """
    Compile a kernel for the types of ``arguments`` and return the compiled function itself.

    numba's dispatcher checks the type of each argument at each call, which for record arrays costs
    more than the kernel: 0.6 us against 0.2 us. The caller is responsible for the types. The
    kernel runs once and may overwrite ``arguments``.
    """
    function(*arguments)
    if INTERPRETED:
        return function
    code: Callable[..., None] = function.overloads[function.signatures[-1]].entry_point
    return code
