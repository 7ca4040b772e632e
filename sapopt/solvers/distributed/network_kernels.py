# mypy: allow-untyped-defs, allow-incomplete-defs
"""Compiled graph searches."""

from __future__ import annotations

import numpy as np

from sapopt.kernels.jit import njit


@njit(cache=True, nogil=True)
def hop_distances(link_start, links):
    """Hops between all pairs, -1 if unreachable: breadth-first from 64 agents at once, one bit for each."""
    n = len(link_start) - 1
    out = np.full((n, n), -1, np.int16)
    seen = np.zeros(n, np.uint64)
    fresh = np.zeros(n, np.uint64)
    for first in range(0, n, 64):
        count = min(64, n - first)
        seen[:] = 0
        for b in range(count):
            seen[first + b] = np.uint64(1) << np.uint64(b)
            out[first + b, first + b] = 0
        level = 0
        while True:
            level += 1
            moved = False
            for i in range(n):
                bits = np.uint64(0)
                for e in range(link_start[i], link_start[i + 1]):
                    bits |= seen[links[e]]
                fresh[i] = bits & ~seen[i]
            for i in range(n):
                bits = fresh[i]
                if bits == 0:
                    continue
                moved = True
                seen[i] |= bits
                for b in range(count):
                    if (bits >> np.uint64(b)) & np.uint64(1):
                        out[first + b, i] = level
            if not moved:
                break
    return out
