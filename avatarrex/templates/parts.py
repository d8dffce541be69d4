"""The parts of a person with templates and fields of their own (sec. 3.2, 3.3): the one source of their names and order.

Part weights (`part_weight (…, 3)`, `PARTS` its last axis), files and counters follow this order everywhere.
"""

from __future__ import annotations

HANDS = ("left_hand", "right_hand")
PARTS = (*HANDS, "face")
PART_JOINT = {"left_hand": 20, "right_hand": 21, "face": 15}
"""The joint in whose frame a part lives: wrists and head (SMPL-X order)."""
