"""One UDP port: a thread reads datagrams and keeps the newest of what they say.

Datagrams beyond `MOST` a second are dropped unread. Malformed ones are counted, end nothing, and change nothing.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from avatarrex_studio.live.received import Received

from avatarrex.errors import InputError

LOOPBACK = "127.0.0.1"
MOST = 6000
"""Datagrams a second: VMC sends a bone each, a hundred a frame."""
BYTES = 65_535
WAKE = 0.2
"""Seconds after which the thread looks whether it should end."""
RATE_OVER = 1.0
"""Seconds over which the rate is counted."""


@dataclass(frozen=True)
class Counts:
    """Datagrams so far, and those of the last second."""

    received: int = 0
    malformed: int = 0
    dropped: int = 0
    rate: int = 0


class Receiver:
    """Listens from the moment that it is made until `close`."""

    def __init__(
        self,
        decode: Callable[[bytes], Received | None],
        address: str,
        port: int,
        arrived: Callable[[], None] = lambda: None,
    ) -> None:
        """`arrived` is called by the thread when something new has come. Raises `InputError` where the port cannot be had."""
        self.address, self.port = address, port
        self._decode, self._arrived = decode, arrived
        self._lock = threading.Lock()
        self._latest, self._at = Received(), float("-inf")
        self._received = self._malformed = self._dropped = 0
        self._times: deque[float] = deque()
        self._closed = False
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.settimeout(WAKE)
            self._socket.bind((address, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise InputError(f"{address}:{port}", "", "a free UDP port to listen at", error) from None
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._listen, name=f"live {port}", daemon=True)
        self._thread.start()

    @property
    def where(self) -> str:
        """Address and port."""
        return f"{self.address}:{self.port}"

    @property
    def counts(self) -> Counts:
        """What came so far."""
        now = time.monotonic()
        with self._lock:
            self._forget(now)
            return Counts(self._received, self._malformed, self._dropped, len(self._times))

    def latest(self) -> tuple[Received, float]:
        """All that was said last, and when (`time.monotonic`); minus infinity before anything came."""
        with self._lock:
            return self._latest, self._at

    def greet(self, address: str, words: bytes) -> None:
        """Send a datagram to a phone that waits for one, at the same port. Raises `InputError`."""
        try:
            self._socket.sendto(words, (address, self.port))
        except OSError as error:
            raise InputError(address, "", "the address of a phone", error) from None

    def close(self) -> None:
        """Listen no more."""
        self._closed = True
        self._socket.close()
        self._thread.join(2 * WAKE)

    def _listen(self) -> None:
        while not self._closed:
            try:
                data = self._socket.recv(BYTES)
            except TimeoutError:
                continue
            except OSError:  # a datagram that could not be delivered, or the end
                if not self._closed:
                    time.sleep(0.01)
                continue
            self.take(data, time.monotonic())

    def take(self, data: bytes, now: float) -> None:
        """Have a datagram that came at a time."""
        with self._lock:
            self._forget(now)
            self._received += 1
            if len(self._times) >= MOST:
                self._dropped += 1
                return
            self._times.append(now)
        try:
            said = self._decode(data)
        except Exception:  # whatever a stranger sends ends nothing
            with self._lock:
                self._malformed += 1
            return
        if said is None or said == Received():
            return
        with self._lock:
            self._latest, self._at = said.over(self._latest), now
        self._arrived()

    def _forget(self, now: float) -> None:
        while self._times and now - self._times[0] > RATE_OVER:
            self._times.popleft()
