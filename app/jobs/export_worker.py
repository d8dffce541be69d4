"""The process that writes one export: it tells how far it is, and ends early when it is told to or its pipe breaks."""

from __future__ import annotations

import _thread
import logging
import os
import signal
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection

from avatarrex_studio.jobs.export_order import Make, Order

from avatarrex.errors import InputError

log = logging.getLogger(__name__)
CANCEL = "cancel"
NICENESS = 10
"""The interface and its pictures come first."""


@dataclass(frozen=True)
class Ended:
    """What became of the order: `error` says why there is no file."""

    error: InputError | str | None = None
    cancelled: bool = False


def serve(connection: Connection, order: Order, make: Make) -> None:
    """The process's main function: sends numbers of steps that are done, then one `Ended`."""
    for number in (signal.SIGINT, signal.SIGTERM):  # the second one ends processes that are left when the program ends
        signal.signal(number, signal.default_int_handler)
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    threading.Thread(target=_listen, args=(connection,), daemon=True).start()
    try:
        order.write(make, connection.send)
        ended = Ended()
    except KeyboardInterrupt:
        ended = Ended(cancelled=True)
    except InputError as error:
        ended = Ended(error)
    except Exception as error:  # a fault of ours: its trace goes to the log, its line to the window
        log.exception("the export failed")
        ended = Ended(f"{type(error).__name__}: {error}".splitlines()[0])
    try:
        connection.send(ended)
    except OSError:
        log.debug("nobody waits for the export any more")


def _listen(connection: Connection) -> None:
    """Interrupt the work when a word comes, or the window is gone."""
    try:
        connection.recv()
    except (EOFError, OSError):
        log.debug("the window is gone")
    _thread.interrupt_main()
