"""What the log tells a user outright: results, beside the warnings and errors that everybody sees."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from avatarrex.errors import InputError

NOTICE = logging.INFO + 5
"""Level of lines such as where a picture was written: nothing is wrong, and a user should see it."""
logging.addLevelName(NOTICE, "NOTICE")
log = logging.getLogger(__name__)


@contextmanager
def refusals_logged(opening: object = "") -> Iterator[None]:
    """An `InputError` ends the block and becomes a line of the log; about a file that a user is `opening` it becomes a dialog."""
    try:
        yield
    except InputError as error:
        log.error("%s", error, extra={"opening": str(opening)} if opening else None)
