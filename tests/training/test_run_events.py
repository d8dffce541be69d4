"""Event files: TensorBoard reads the same numbers from the same folder, and our reader stands what it may meet."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import masked_crc32c

from avatarrex.training.runs.events import EventReader, event_files
from avatarrex.training.runs.folder import Run


def write(path, steps, offset=0.0, resume=False):
    with Run.open(path) if resume else Run.create(path, {}) as run:
        for step in steps:
            run.scalars(step, {"body/loss/rgb": np.sin(step) + offset, "body/rate/steps_per_s": step / 3})


def read(path, limit=1 << 20):
    reader = EventReader(path)
    while reader.poll(limit):
        pass
    return reader


def test_tensorboard_reads_the_same_values(tmp_path):
    write(tmp_path, range(20))
    write(tmp_path, range(15, 40), 0.25, resume=True)
    with Run.open(tmp_path) as run:
        run.picture(40, "body/walk/render", np.random.default_rng(0).integers(0, 256, (120, 90, 3), np.uint8))
        run.scalars(40, {"body/loss/rgb": float("nan")})
    ours, theirs = read(tmp_path), EventAccumulator(str(tmp_path))
    theirs.Reload()
    assert theirs.Tags()["scalars"] == list(ours.tags) == ["body/loss/rgb", "body/rate/steps_per_s"]
    for tag in ours.tags:
        last = {event.step: (event.value, event.wall_time) for event in theirs.Scalars(tag)}
        series = ours.series(tag)
        assert series.steps.tolist() == sorted(last)
        assert np.array_equal(series.values, [last[step][0] for step in sorted(last)], equal_nan=True)
        assert series.times.tolist() == [last[step][1] for step in sorted(last)]
    rgb = ours.series("body/loss/rgb")
    assert rgb.steps.tolist() == list(range(41))
    assert rgb.values[14] == np.float32(np.sin(14))
    assert rgb.values[15] == np.float32(np.sin(15) + 0.25), "the later value counts"
    image = theirs.Images("samples/body/walk/render")[0]
    assert (image.width, image.height) == (90, 120)
    file = tmp_path / "samples/body/walk/render/step_00000040.png"
    assert image.encoded_image_string == file.read_bytes()


@pytest.mark.parametrize("limit", [1 << 20, 300])
def test_every_cut_of_a_file_gives_what_is_whole(tmp_path, limit):
    write(tmp_path, range(6))
    file = event_files(tmp_path)[0]
    content = file.read_bytes()
    seen = []
    for size in range(0, len(content) + 1, 7):
        file.write_bytes(content[:size])
        reader = read(tmp_path, limit)
        seen.append(len(reader.series("body/loss/rgb").steps))
        assert not reader.notes
    assert seen == sorted(seen)
    assert seen[0] == 0
    assert seen[-1] >= 5


def test_a_growing_file_is_followed(tmp_path):
    reader = EventReader(tmp_path / "run")
    assert not reader.poll()
    with Run.create(tmp_path / "run", {}) as run:
        for step in range(5):
            run.scalars(step, {"a": step})
            before = reader.count
            reader.poll()
            assert reader.count == before + 1
            assert reader.series("a").values.tolist() == list(range(step + 1))
    count = reader.count
    reader.poll()
    assert reader.count == count


def test_half_a_record_waits_until_it_is_whole(tmp_path):
    write(tmp_path, range(4))
    file = event_files(tmp_path)[0]
    content = file.read_bytes()
    file.write_bytes(content[:-9])
    reader = read(tmp_path)
    assert len(reader.series("body/loss/rgb").steps) == 3
    file.write_bytes(content)
    reader.poll()
    assert reader.series("body/loss/rgb").steps.tolist() == [0, 1, 2, 3]


def test_after_a_torn_end_the_next_file_is_read(tmp_path):
    write(tmp_path, range(4))
    file = event_files(tmp_path)[0]
    file.write_bytes(file.read_bytes()[:-9])
    write(tmp_path, range(3, 8), resume=True)
    ours, theirs = read(tmp_path), EventAccumulator(str(tmp_path))
    theirs.Reload()
    assert ours.series("body/loss/rgb").steps.tolist() == list(range(8))
    assert [event.step for event in theirs.Scalars("body/loss/rgb")] == list(range(8))


def test_broken_bytes(tmp_path):
    write(tmp_path, range(4))
    file = event_files(tmp_path)[0]
    content = file.read_bytes()
    ends = [0]
    while ends[-1] < len(content):
        ends.append(ends[-1] + 16 + struct.unpack_from("<Q", content, ends[-1])[0])
    inside, header = bytearray(content), bytearray(content)
    inside[ends[2] + 20] ^= 1
    header[ends[3] + 3] ^= 1
    file.write_bytes(inside)
    reader = read(tmp_path)
    assert reader.series("body/loss/rgb").steps.tolist() == [0, 2, 3], "one broken content is passed over"
    assert not reader.notes
    file.write_bytes(header)
    reader = read(tmp_path)
    assert reader.series("body/loss/rgb").steps.tolist() == [0, 1]
    assert list(reader.notes.values()) == [f"a broken record at byte {ends[3]}"]


def test_strange_files(tmp_path):
    write(tmp_path, range(2))
    good = event_files(tmp_path)[0].name
    junk = b"\x00" * 50
    (tmp_path / "events.out.tfevents.0000000000.zeros").write_bytes(junk)
    (tmp_path / "events.out.tfevents.0000000001.text").write_bytes(b"<html>nothing of the kind</html>")
    (tmp_path / "events.out.tfevents.0000000002.folder").mkdir()
    no_event = b"\xff\xff\xff"
    length = struct.pack("<Q", 3)
    record = length + struct.pack("<I", masked_crc32c(length)) + no_event + struct.pack("<I", masked_crc32c(no_event))
    (tmp_path / "events.out.tfevents.0000000003.noevent").write_bytes(record)
    reader = read(tmp_path)
    assert reader.series("body/loss/rgb").steps.tolist() == [0, 1]
    assert good not in reader.notes
    assert len(reader.series("no such tag").steps) == 0
