"""The kinds of live sources: what they are called, where they are listened for, what their datagrams say and what they drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from avatarrex_studio.live import ifacialmocap_packet, livelink_packet, osc_packet
from avatarrex_studio.live.received import Received

FACE = ("head", "lids", "upper face", "mouth")


WEBCAM = "webcam"
"""The source that is no port: `webcam.py`."""


@dataclass(frozen=True)
class Source:
    """A kind of source."""

    title: str
    port: int
    decode: Callable[[bytes], Received | None]
    parts: tuple[str, ...]
    """What it drives, of the timeline's `PARTS`."""
    hello: bytes = b""
    """What a phone waits for; empty: nothing."""


SOURCES: dict[str, Source] = {
    "osc": Source(
        "OSC / VMC", 39539, osc_packet.decode,
        ("torso", "left arm", "right arm", "legs", "head", "left hand", "right hand", "lids", "upper face", "mouth", "jaw", "eyes"),
    ),
    "livelink": Source("Live Link Face", 11111, livelink_packet.decode, FACE),
    "ifacialmocap": Source("iFacialMocap", 49983, ifacialmocap_packet.decode, FACE, ifacialmocap_packet.HELLO),
}  # fmt: skip
