"""What `write_json` writes meets assets_spec/signals.json, and the schema refuses what the reader refuses."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from avatarrex.files.assets import SPECS
from avatarrex.signals.driving import SHAPES
from avatarrex.signals.limits import random_signals
from avatarrex.signals.read import write_json
from avatarrex.signals.sequence import SignalSequence

SCHEMA = json.loads((SPECS / "signals.json").read_text(encoding="utf-8"))
KINDS = {"object": dict, "array": list, "string": str, "number": (int, float)}


def faults(value: Any, rule: dict[str, Any], place: str = "file") -> list[str]:
    """The part of JSON Schema that signals.json uses; an unknown keyword is a fault of the schema."""
    if "$ref" in rule:
        return faults(value, SCHEMA["$defs"][rule["$ref"].rsplit("/", 1)[1]], place)
    known = {
        "$schema", "$defs", "title", "description", "type", "const", "required", "additionalProperties", "properties",
        "items", "minItems", "maxItems", "exclusiveMinimum", "maximum",
    }  # fmt: skip
    found = [f"{place}: unknown keyword {key}" for key in rule.keys() - known]
    if "const" in rule:
        return found + ([] if value == rule["const"] else [f"{place}: not {rule['const']}"])
    if not isinstance(value, KINDS[rule["type"]]) or isinstance(value, bool):
        return [*found, f"{place}: not {rule['type']}"]
    if isinstance(value, dict):
        found += [f"{place}: no {key}" for key in rule.get("required", ()) if key not in value]
        found += [f"{place}: unknown {key}" for key in value.keys() - rule["properties"].keys()]
        for key in value.keys() & rule["properties"].keys():
            found += faults(value[key], rule["properties"][key], f"{place}.{key}")
    if isinstance(value, list):
        if not rule.get("minItems", 0) <= len(value) <= rule.get("maxItems", np.inf):
            found.append(f"{place}: {len(value)} items")
        for k, item in enumerate(value):
            found += faults(item, rule["items"], f"{place}[{k}]")
    if isinstance(value, int | float) and not rule.get("exclusiveMinimum", -np.inf) < value <= rule.get(
        "maximum", np.inf
    ):
        found.append(f"{place}: {value} out of range")
    return found


@pytest.fixture
def written(tmp_path: Path) -> dict[str, Any]:
    frames = tuple(random_signals(np.random.default_rng(k)) for k in range(2))
    write_json(tmp_path / "m.json", SignalSequence(frames, 24.0, "mine", ("a note",)))
    return json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))


def test_the_writer_meets_the_spec(written: dict[str, Any]) -> None:
    assert faults(written, SCHEMA) == []
    assert set(SCHEMA["$defs"]["frame"]["properties"]) == set(SHAPES)
    assert set(written) == set(SCHEMA["properties"])


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda data: data.update(fps=0), "fps"),
        (lambda data: data.update(version=2), "version"),
        (lambda data: data.update(mood="good"), "mood"),
        (lambda data: data.pop("frames"), "frames"),
        (lambda data: data["frames"][1]["body_pose"].pop(), r"frames\[1\].body_pose: 20 items"),
        (lambda data: data["frames"][0]["jaw_pose"].append(0.0), r"frames\[0\].jaw_pose: 4 items"),
        (lambda data: data["frames"][0].update(hand=[]), "hand"),
    ],
)
def test_the_spec_refuses_other_files(written: dict[str, Any], change, place: str) -> None:
    data = copy.deepcopy(written)
    change(data)
    with pytest.raises(AssertionError, match=place):
        assert faults(data, SCHEMA) == []
