"""Messages of the exact engine's pipe: large arrays cross in slices.

Whoever unpickles an array keeps Python's lock while it is copied, and the interface's thread waits for it; a slice takes a
fraction of a millisecond. The arrays lie in the memory that they are received into (pickle protocol 5, out of band).
"""

from __future__ import annotations

import pickle
from multiprocessing.connection import Connection

import numpy as np

SLICE = 1 << 20
"""Bytes."""


def send(connection: Connection, message: object) -> None:
    """Any value; its contiguous arrays in slices."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
    blocks = [buffer.raw() for buffer in buffers]
    connection.send((head, [block.nbytes for block in blocks]))
    for block in blocks:
        for start in range(0, block.nbytes, SLICE):
            connection.send_bytes(block[start : start + SLICE])


def receive(connection: Connection) -> object:
    """The next value that `send` sent. Raises `EOFError` or `OSError` where the other end is gone."""
    head, sizes = connection.recv()
    blocks = [np.empty(size, np.uint8) for size in sizes]
    for block in blocks:
        for start in range(0, block.nbytes, SLICE):
            connection.recv_bytes_into(block[start : start + SLICE])
    value: object = pickle.loads(head, buffers=blocks)
    return value
