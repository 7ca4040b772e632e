"""A binary heap in two arrays: keys, and what they belong to."""

from __future__ import annotations

from sapopt.kernels.jit import njit


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def push(key, item, size, value, what):
    """Add an entry to a heap of `size` entries; returns the new size."""
    q = size
    while q > 0:
        parent = (q - 1) >> 1
        if key[parent] <= value:
            break
        key[q] = key[parent]
        item[q] = item[parent]
        q = parent
    key[q] = value
    item[q] = what
    return size + 1


@njit(cache=True, nogil=True, no_cpython_wrapper=True)
def pop(key, item, size):
    """Drop the entry of the least key, which is entry 0; returns the new size."""
    size -= 1
    value = key[size]
    what = item[size]
    q = 0
    while True:
        child = 2 * q + 1
        if child >= size:
            break
        if child + 1 < size and key[child + 1] < key[child]:
            child += 1
        if key[child] >= value:
            break
        key[q] = key[child]
        item[q] = item[child]
        q = child
    key[q] = value
    item[q] = what
    return size
