"""
One file a contestant of ``benchmarks/peers.py``: the whole of what its user writes.

``READING`` says which reading of the jumps at e = 0 it solves, ``KIND`` what it runs as and
``PACKAGES`` what it needs. ``prepare(case)`` builds and compiles, untimed, and returns the
function that is timed: one run (or ``RUNS`` runs), which returns its own times [s] and positions
[m]. Files of peers import nothing of ours.
"""
