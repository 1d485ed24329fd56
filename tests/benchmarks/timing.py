"""Medians of processor time, and what the processor can do at most."""

import ctypes
import time

import numpy as np


def median(run, *, repeats=31, clock=time.thread_time):
    """Median seconds of ``run()``; by default the thread's own processor time.

    On a machine that does nothing else that is wall time; on a busy one it leaves out the time
    that others had the core.
    """
    run()
    spent = []
    for _ in range(repeats):
        start = clock()
        run()
        spent.append(clock() - start)
    return float(np.median(spent))


def several(runs, *, rounds=5):
    """Medians of several runs, taken in turns so that all meet the same machine."""
    spent = [[median(run, repeats=7) for run in runs] for _ in range(rounds)]
    return np.median(spent, axis=0)


def peak_operations(library):
    """Additions and multiplications a second, at most, of a library made of peak.c."""
    library.peak.argtypes = [ctypes.c_int64]
    library.peak.restype = ctypes.c_double
    rounds = 100_000
    return 14 * rounds / median(lambda: library.peak(rounds))
