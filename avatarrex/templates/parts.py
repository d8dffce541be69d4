"""The parts of a person with templates and fields of their own (sec. 3.2, 3.3): the one source of their names and order.

Part weights (`part_weight (…, 3)`, `PARTS` its last axis), files and counters follow this order everywhere.
"""

HANDS = ("left_hand", "right_hand")
PARTS = (*HANDS, "face")
