"""The type checker of the test runs: beartype, with an int where a float is expected (PEP 484's numeric tower).

A function within a function is not checked: it is made, and its check would be compiled, at each call of the outer one, 7 ms each
time. A frame of the window took 200 ms of that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, beartype

_check: Callable[[Any], Any] = beartype(conf=BeartypeConf(is_pep484_tower=True))


def check(checked: Any) -> Any:
    """`checked`, a function or a class, with its annotations checked at each call."""
    return checked if "<locals>" in checked.__qualname__ else _check(checked)
