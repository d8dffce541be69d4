"""Live sources without a window: what datagrams say, hostile ones, drop-out, calibration, recording. Packets go over loopback."""

from __future__ import annotations

import errno
import json
import logging
import random
import socket
import sys
import time
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from avatarrex_studio.live import ifacialmocap_packet, livelink_packet, osc_packet
from avatarrex_studio.live.drive import Drive
from avatarrex_studio.live.listening import evenly
from avatarrex_studio.live.received import Received
from avatarrex_studio.live.receiver import MOST, Counts, Receiver
from avatarrex_studio.live.replay import Replay
from avatarrex_studio.live.sources import SOURCES
from avatarrex_studio.live.webcam import Landmarks, Webcam, replayed
from avatarrex_studio.session.commands import AddFigure, RemoveFigure, SelectFigure, SetExpression
from avatarrex_studio.session.evaluation import state_at
from avatarrex_studio.session.journal import Journal
from avatarrex_studio.session.timeline import Clip, Feed, Layer
from avatarrex_studio.session.timeline_commands import AddLayer, MoveLayer, RenameLayer, SetFrame, SetLayer, SetTimeline
from avatarrex_studio.session.user_library import library_folder, state_folder
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from avatarrex.errors import InputError
from avatarrex.signals.driving import Signals
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.read import read_motion, write_json
from avatarrex.signals.sequence import SignalSequence

JAW = EXPRESSION_NAMES.index("jawOpen")
IFACIAL = b"mouthSmile_R-12|eyeBlink_L-100|jawOpen-50|=head#10.0,20.0,0.0,0.1,0.2,0.3|rightEye#1,2,3|leftEye#1,2,3|"


def message(address, *values):
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return builder.build()


def bundle(*messages):
    builder = OscBundleBuilder(IMMEDIATELY)
    for each in messages:
        builder.add_content(each)
    return builder.build().dgram


def turned(x, y, z, w):
    return message("/VMC/Ext/Bone/Pos", "LeftLowerArm", 0.0, 0.0, 0.0, float(x), float(y), float(z), float(w))


VMC = bundle(
    turned(0, np.sin(0.25), 0, np.cos(0.25)),
    message("/VMC/Ext/Blend/Val", "JawOpen", 0.5),
    message("/VMC/Ext/Blend/Apply"),
)
GOOD = {
    "osc": VMC,
    "livelink": livelink_packet.encode({"jawOpen": 0.5, "jawLeft": 0.3}, (0.4, 0.1, 0.0)),
    "ifacialmocap": IFACIAL,
}


def test_live_link_face():
    said = livelink_packet.decode(GOOD["livelink"])
    assert said.weights["jawOpen"] == pytest.approx(0.5)
    assert (said.weights["jawLeft"], said.weights["jawRight"]) == (pytest.approx(0.3), 0)
    head = livelink_packet.decode(livelink_packet.encode({}, (0.4, 0.0, 0.0))).head
    assert head == pytest.approx([0, 0.4, 0]), "yaw to the person's left, as in recordings"
    pose = said.signals().full_pose()
    assert pose[12] == pytest.approx(pose[15]), "neck and head share the turn"


def test_ifacialmocap_of_both_versions():
    for data in (IFACIAL, IFACIAL.replace(b"-", b"&")):
        said = ifacialmocap_packet.decode(data)
        assert said.weights == pytest.approx({"mouthSmileRight": 0.12, "eyeBlinkLeft": 1.0, "jawOpen": 0.5})
    # Unity's left-handed +y turns from z towards x, its person's right: ours is the other way
    assert ifacialmocap_packet.decode(b"jawOpen-0|=head#0,30,0,0,0,0|").head == pytest.approx([0, -np.radians(30), 0])
    assert ifacialmocap_packet.decode(b"jawOpen-0|=head#30,0,0,0,0,0|").head == pytest.approx([np.radians(30), 0, 0])


def test_vmc_bones_presets_and_coefficients():
    said = osc_packet.decode(VMC)
    assert said.turns["left_elbow"] == pytest.approx([0, -0.5, 0]), (
        "the elbow bends as in Unity, seen in a mirror of its axes"
    )
    assert said.weights == pytest.approx({"jawOpen": 0.5})
    vowel = osc_packet.decode(message("/VMC/Ext/Blend/Val", "A", 1.0).dgram).weights
    assert vowel["jawOpen"] == pytest.approx(0.7)
    assert osc_packet.decode(message("/VMC/Ext/OK", 1).dgram) == Received()
    assert set(osc_packet.BONES.values()) >= {"pelvis", "head", "left_thumb1", "right_pinky3", "left_eye"}


def test_2000_malformed_packets_are_counted_and_end_nothing():
    """Cut, with bytes changed, random, empty; then a good one still comes through."""
    numbers = random.Random(5)
    for name, source in SOURCES.items():
        receiver = Receiver(source.decode, "127.0.0.1", 0)
        try:
            for k in range(2000):
                data = bytearray(GOOD[name])
                way = k % 4
                if way == 0:
                    data = data[: numbers.randrange(len(data))]
                elif way == 1:
                    for _ in range(numbers.randrange(1, 12)):
                        data[numbers.randrange(len(data))] = numbers.randrange(256)
                elif way == 2:
                    data = bytearray(numbers.randbytes(numbers.randrange(400)))
                else:
                    data = data + numbers.randbytes(numbers.randrange(1, 40))
                receiver.take(bytes(data), k / 100)
            counts = receiver.counts
            assert counts.received == 2000
            assert counts.malformed > 500
            latest, _ = receiver.latest()
            latest.signals()
            receiver.take(GOOD[name], 30.0)
            assert receiver.latest()[0].weights["jawOpen"] == pytest.approx(0.5)
        finally:
            receiver.close()


def test_a_flood_is_dropped_unread():
    receiver = Receiver(SOURCES["livelink"].decode, "127.0.0.1", 0)
    for _ in range(MOST + 50):
        receiver.take(b"", 1.0)
    receiver.close()
    assert receiver.counts.dropped == 50


def send(port, *packets):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in packets:
            sender.sendto(data, ("127.0.0.1", port))


def wait(condition, seconds=5.0):
    until = time.monotonic() + seconds
    while not condition() and time.monotonic() < until:
        time.sleep(0.005)
    assert condition()


def test_nothing_listens_until_it_is_switched_on_and_a_taken_port_is_said(studio, caplog):
    studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"))))
    assert studio.listening.words == ""
    arrived = []
    studio.listening.arrived = lambda: arrived.append(1)
    studio.listening.switch_on("Phone", "livelink", port=0)
    port = studio.listening.drives["Phone"].sender.port
    assert studio.listening.words.startswith(f"listening at 127.0.0.1:{port}")
    with pytest.raises(InputError, match="a free UDP port"):
        studio.listening.switch_on("Other", "livelink", port=port)
    send(port, GOOD["livelink"], b"nonsense")
    wait(lambda: studio.listening.drives["Phone"].sender.counts.received == 2)
    assert arrived
    assert "1 malformed" in studio.listening.words
    studio.undo()
    studio.tick((32, 24))
    assert studio.listening.words == "", "what has no layer listens no more"


class Sent:
    """A source that says what a test says."""

    counts, where = Counts(), "a test"

    def __init__(self):
        self.said, self.at, self.closed = Received(), float("-inf"), False

    def latest(self):
        return self.said, self.at

    def close(self):
        self.closed = True


def of_jaw(value, yaw=0.0):
    return Received({"jawOpen": value}, head=np.array([0.0, yaw, 0.0]))


def test_drop_out_keeps_then_fades_and_comes_back():
    sent = Sent()
    drive, now = Drive(sent), 10.0
    presence = []
    for k in range(240):
        now += 1 / 60
        if k < 60 or k > 200:
            sent.said, sent.at = of_jaw(0.6), now
        drive.tick(now)
        presence.append(drive.presence)
    assert presence[59] == presence[85] == 1
    assert 0.3 < presence[60 + 30 + 30] < 0.7, "half a second of the last, then a second to nothing"
    assert presence[199] == 0
    assert presence[-1] == 1
    assert drive.signals.expression[JAW] == pytest.approx(0.6, abs=1e-3)


def test_the_hips_of_vmc_go_from_where_they_were_first():
    """And from a new place where that is made neutral. Unity's x is to the person's right."""
    sent = Sent()
    drive = Drive(sent)

    def at(x, y, z, now):
        packet = message("/VMC/Ext/Bone/Pos", "Hips", x, y, z, 0.0, 0.0, 0.0, 1.0).dgram
        for k in range(60):
            sent.said, sent.at = osc_packet.decode(packet), now + k / 60
            drive.tick(now + k / 60)
        return drive.signals.translation

    assert at(0.1, 0.9, 0.0, 1.0) == pytest.approx(np.zeros(3))
    assert at(0.3, 0.6, 0.4, 2.0) == pytest.approx([-0.2, -0.3, 0.4], abs=0.01)
    drive.calibrate()
    assert at(0.3, 0.7, 0.4, 3.0) == pytest.approx([0.0, 0.1, 0.0], abs=0.01)
    elbow = osc_packet.decode(VMC)
    assert elbow.place is None


def test_a_face_is_calibrated_to_neutral():
    sent = Sent()
    drive = Drive(sent)
    sent.said, sent.at = of_jaw(0.2, yaw=0.3), 1.0
    drive.calibrate()
    drive.tick(1.0)
    assert drive.signals == Signals.rest()
    sent.said, sent.at = of_jaw(0.6, yaw=0.7), 5.0
    drive.tick(5.0)
    assert drive.signals.expression[JAW] == pytest.approx(0.5)
    assert drive.signals.full_pose()[15] == pytest.approx([0, 0.2, 0])


def test_frames_are_passed_on_sixty_times_a_second_at_most():
    sent = Sent()
    drive, passed = Drive(sent), 0
    for k in range(1000):
        sent.said, sent.at = of_jaw(0.001 * k), k / 1000
        passed += drive.tick(k / 1000)
    assert 50 <= passed <= 67


def test_a_recording_that_is_kept_while_something_plays_is_one_step(studio, clock):
    """Undone once, it is gone, with what was played after it; undone twice, what was played before it is, too."""
    studio.open_motion("wave")
    studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"), parts=frozenset({"expression", "mouth", "head"}))))
    sent = Sent()
    studio.listening.take_up("Phone", sent)
    names, steps = [layer.name for layer in studio.state.timeline.layers], len(studio.journal.steps)

    def play(frames):
        for k in range(frames):
            clock.now += 1 / 30
            sent.said, sent.at = of_jaw(k / 100), clock.now
            studio.tick((32, 24))

    studio.toggle_play()
    play(10)
    studio.record_live("Phone")
    play(10)
    before = studio.state.timeline.frame
    studio.record_live("Phone")
    play(10)
    studio.toggle_play()
    assert len(studio.state.timeline.layers) == len(names) + 1
    assert len(studio.journal.steps) == steps + 2, "played, and kept"
    studio.undo()
    assert [layer.name for layer in studio.state.timeline.layers] == names
    assert not studio.state.timeline.layer("Phone").muted
    assert studio.state.timeline.frame == before
    studio.undo()
    assert studio.state.timeline.frame == 0


def test_a_live_layer_is_smoothed_recorded_and_replayed(studio, clock, tmp_path):
    """Live frames are no undo steps; the recording becomes a clip; the journal gives the same state without either."""
    studio.do(SetExpression("browInnerUp", 0.2))
    studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"), parts=frozenset({"expression", "mouth", "head"}))))
    sent = Sent()
    studio.listening.take_up("Phone", sent)
    steps = len(studio.journal.steps)
    studio.record_live("Phone")
    for k in range(60):
        clock.now += 1 / 60
        sent.said, sent.at = of_jaw(k / 100), clock.now
        studio.tick((32, 24))
    assert studio.state.signals.expression[JAW] == pytest.approx(0.59, abs=0.05)
    assert len(studio.journal.steps) == steps, "nobody did it"
    studio.record_live("Phone")
    clip = studio.state.timeline.layers[-1]
    assert clip.clip.frames == pytest.approx(60, abs=2)
    assert studio.state.timeline.layer("Phone").muted
    studio.go_to(15)  # of 30 a second
    assert studio.state.signals.expression[JAW] == pytest.approx(0.3, abs=0.06)
    studio.save_session(str(tmp_path / "s.json"))
    assert Journal.load(tmp_path / "s.json").state == studio.state
    studio.undo()
    studio.undo()
    assert len(studio.state.timeline.layers) == 1, "the clip came with one step"
    assert not studio.state.timeline.layer("Phone").muted


def two_phones(studio):
    """Two figures, each with a live layer of the same name; the second is selected."""
    face = frozenset({"expression", "mouth", "head"})
    sent = []
    for number in range(2):
        if number:
            studio.do(AddFigure("default"))
        studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"), parts=face)))
        sent.append(Sent())
        studio.listening.take_up(studio.state.timeline.layer("Phone").live, sent[-1])
    return sent


def jaws(studio):
    """Of all figures."""
    return [figure.signals.expression[JAW] for figure in studio.state.figures]


def listen(studio, clock, sent, values, seconds=0.6):
    """Have the sources send for a while; None: nothing."""
    for _ in range(round(60 * seconds)):
        clock.now += 1 / 60
        for source, value in zip(sent, values):
            if value is not None:
                source.said, source.at = of_jaw(value), clock.now
        studio.tick((32, 24))


def test_two_figures_with_a_live_layer_of_one_name_each_have_a_source_of_their_own(studio, clock, tmp_path):
    """Both are moved, whoever is selected; a figure that is taken away takes its source along."""
    sent = two_phones(studio)
    assert len(studio.listening.drives) == 2
    listen(studio, clock, sent, (0.3, 0.8))
    assert jaws(studio) == pytest.approx([0.3, 0.8], abs=0.02)
    studio.do(SelectFigure(0))
    listen(studio, clock, sent, (0.6, 0.1))
    assert jaws(studio) == pytest.approx([0.6, 0.1], abs=0.02)
    studio.save_session(str(tmp_path / "s.json"))
    assert Journal.load(tmp_path / "s.json").state == studio.state
    studio.do(RemoveFigure(1))
    listen(studio, clock, sent, (0.2, 0.9))
    assert jaws(studio) == pytest.approx([0.2], abs=0.02)
    assert (sent[0].closed, sent[1].closed) == (False, True)


def test_live_layers_of_one_figure_have_sources_of_their_own_whatever_they_are_called(studio, clock):
    """The second figure has *Phone*, listened for as 'Phone 2', and adds one of that name; a later one is called so."""
    two_phones(studio)
    for name in ("Phone 2", "Laptop"):
        studio.do(AddLayer(Layer(name, feed=Feed("livelink"))))
    studio.do(RenameLayer("Phone", "Camera"))
    studio.do(RenameLayer("Laptop", "Phone"))
    first, second = (figure.timeline for figure in studio.state.figures)
    assert [layer.live for layer in first.layers] == ["Phone"]
    assert [layer.live for layer in second.layers] == ["Phone 2", "Phone 2 2", "Phone 3"]
    assert Journal.from_json(json.loads(json.dumps(studio.journal.to_json()))).state == studio.state


def test_a_layer_that_is_renamed_takes_no_source_of_another(studio):
    """Whoever was given a name to be listened for as keeps it."""
    two_phones(studio)
    studio.do(AddLayer(Layer("Laptop", feed=Feed("livelink"))))
    studio.do(MoveLayer("Laptop", -1))
    studio.do(RenameLayer("Laptop", "Phone 2"))
    assert [(layer.name, layer.live) for layer in studio.state.timeline.layers] == [
        ("Phone 2", "Phone 2 2"),
        ("Phone", "Phone 2"),
    ]


def test_a_recording_that_is_kept_is_told_by_the_name_of_its_layer(studio, clock, caplog):
    sent = two_phones(studio)
    studio.record_live("Phone")
    listen(studio, clock, sent, (None, 0.7), 0.2)
    with caplog.at_level(logging.INFO):
        studio.listening.switch_off("Phone 2")
    assert "The recording of Phone is kept: " in caplog.text


def test_a_recording_survives_a_library_that_cannot_be_written(studio, clock, monkeypatch, tmp_path, caplog):
    """It goes on where its file cannot be written; where its source ends it is kept in the folder of the program's state."""
    (sent,) = two_phones(studio)[:1]
    studio.do(SelectFigure(0))
    studio.record_live("Phone")
    listen(studio, clock, (sent,), (0.3,), 0.2)
    (tmp_path / "file").write_text("no folder")
    for full in (tmp_path / "file", tmp_path / "disk"):
        monkeypatch.setenv("AVATARREX_LIBRARY", str(full))
        with monkeypatch.context() as patched:
            if full.name == "disk":
                patched.setattr("pathlib.Path.write_text", full_disk)
            studio.record_live("Phone")
        assert len(studio.listening.drives["Phone"].take) >= 10, "nothing is lost, and it goes on"
        assert [layer.name for layer in studio.state.timeline.layers] == ["Phone"]
        assert f"{full.name}" in caplog.records[-1].message
    monkeypatch.setenv("AVATARREX_LIBRARY", str(tmp_path / "file"))
    with caplog.at_level(logging.INFO):
        studio.listening.close()
    (kept,) = (state_folder() / "takes").glob("*.json")
    assert len(read_motion(kept)) >= 10
    assert f"The recording of Phone is kept: {kept}" in caplog.text


def full_disk(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_recording_of_nothing_ends(studio, clock, caplog):
    two_phones(studio)
    studio.record_live("Phone")
    studio.record_live("Phone")
    assert studio.listening.drives["Phone 2"].take is None
    assert "Phone: recording: expected two frames or more" in caplog.text


def test_what_was_sent_to_an_avatar_that_is_not_selected_is_kept(studio, clock, tmp_path):
    """In exports and sessions; and once it has faded nobody else's timeline computes that avatar again."""
    sent = two_phones(studio)
    listen(studio, clock, sent, (None, 0.8))
    studio.do(SelectFigure(0))
    listen(studio, clock, sent, (None, 0.4))
    exported = [state_at(studio.state, frame / 30, studio.clips).figures[1] for frame in range(3)]
    assert [figure.signals.expression[JAW] for figure in exported] == pytest.approx([0.4] * 3, abs=0.02)
    listen(studio, clock, sent, (0.2, None), 2.0)
    assert jaws(studio) == pytest.approx([0.2, 0.0], abs=0.02)
    studio.save_session(str(tmp_path / "s.json"))
    opened = Journal.load(tmp_path / "s.json").state
    assert opened == studio.state
    assert state_at(opened, 0.1, studio.clips).figures[1].signals.expression[JAW] == 0
    studio.do(SetLayer("Phone", weight=0.5))
    command = studio.journal.steps[-1].commands[-1]
    assert isinstance(command, SetLayer)
    assert not {"others", "sent"} & set(command.to_json())


def test_what_was_sent_is_kept_beside_a_motion_that_cannot_be_read(studio, clock):
    """The avatar stays as it is until its motion is there."""
    sent = two_phones(studio)
    gone = Clip("gone.bvh", "gone", 9, 30.0)
    studio.do(AddLayer(Layer("gone", gone)))
    studio.do(SelectFigure(0))
    listen(studio, clock, sent, (None, 0.4))
    kept = studio.state.figures[1].timeline.layer("Phone").feed
    assert kept.signals.expression[JAW] == pytest.approx(0.4, abs=0.02)
    again = Journal.from_json(json.loads(json.dumps(studio.journal.to_json())))
    assert again.state == studio.state
    with pytest.raises(InputError, match="feeds of 1 figures"):
        SetFrame(0, others=(None,), sent=((), ())).apply(studio.state)


def test_what_sends_no_more_fades_out_of_the_face(studio, clock):
    """The last frame stays for half a second; half a second later half of it is left."""
    studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"), parts=frozenset({"expression", "mouth"}))))
    sent = Sent()
    studio.listening.take_up("Phone", sent)
    listen(studio, clock, (sent,), (0.8,))
    for seconds, left in ((0.45, 0.8), (0.55, 0.4), (0.6, 0.0)):
        listen(studio, clock, (sent,), (None,), seconds)
        assert jaws(studio) == pytest.approx([left], abs=0.05)


def test_a_recording_goes_on_for_its_avatar_while_another_is_selected(studio, clock):
    """And is kept as a file where its avatar is taken away."""
    sent = two_phones(studio)
    studio.record_live("Phone")
    listen(studio, clock, sent, (None, 0.7), 0.5)
    studio.do(SelectFigure(0))
    assert "Phone" in studio.listening.drives
    studio.record_live("Phone")
    listen(studio, clock, sent, (0.2, 0.7), 0.5)
    studio.do(SelectFigure(1))
    studio.record_live("Phone")
    first, second = studio.state.figures
    assert [layer.name for layer in first.timeline.layers] == ["Phone"]
    clip = second.timeline.layers[-1].clip
    assert clip.frames == pytest.approx(60, abs=2)
    assert studio.clips.motion(clip).sequence.frames[50].expression[JAW] == pytest.approx(0.7, abs=0.02)
    studio.do(RemoveFigure(0))
    listen(studio, clock, sent, (0.2, 0.7), 0.1)
    takes = sorted((library_folder() / "takes").glob("*.json"))
    assert len(takes) == 2, "nothing that was recorded is lost"


@pytest.mark.parametrize("repeats", [True, False])
def test_a_recording_beyond_the_end_of_a_shorter_timeline(studio, clock, tmp_path, repeats):
    """Beside a longer motion. Where its own repeats, it lies in the round that was shown, and that goes on; else at the playhead."""
    studio.open_motion(walk(tmp_path / "long.json", 300))
    studio.do(AddFigure("default"))
    studio.open_motion(walk(tmp_path / "short.json", 90))
    studio.do(AddLayer(Layer("Phone", feed=Feed("livelink"), parts=frozenset({"mouth"}))))
    studio.do(SetTimeline(loop=repeats))
    sent = Sent()
    studio.listening.take_up("Phone", sent)
    studio.go_to(200)
    studio.toggle_play()
    studio.record_live("Phone")
    for _ in range(30):
        clock.now += 1 / 60
        sent.said, sent.at = of_jaw(0.5), clock.now
        studio.tick((32, 24))
    studio.record_live("Phone")
    timeline = studio.state.timeline
    assert timeline.layers[-1].offset == pytest.approx((200 % 90 if repeats else 200) / 30)
    assert timeline.frames == (90 if repeats else pytest.approx(215, abs=2))
    assert studio.state.frames == 300


def walk(path, frames):
    """A motion file that moves by a centimetre a frame."""
    poses = tuple(Signals.rest().replace(translation=np.array([0.0, 0.0, 0.01 * k])) for k in range(frames))
    write_json(path, SignalSequence(poses, 30.0, path.stem))
    return str(path)


def test_a_recording_of_uneven_times_is_even():
    def at(value):
        return Signals.rest().replace(expression=np.eye(52)[JAW] * value)

    made = evenly([(0.0, at(0.0)), (0.05, at(0.05)), (0.3, at(0.3)), (1.0, at(1.0))], "take", fps=10.0)
    assert [frame.expression[JAW] for frame in made] == pytest.approx(np.arange(11) / 10)


def test_a_webcam_s_landmarks_drive_the_face(tmp_path):
    """From recorded results of a landmarker: no model file comes with the program."""
    frames = [
        {"time": k / 30, "weights": {"jawOpen": k / 10, "_neutral": 1.0}, "matrix": np.eye(4).tolist()}
        for k in range(5)
    ]
    frames[4]["matrix"][0][:3], frames[4]["matrix"][2][:3] = [0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]
    (tmp_path / "face.jsonl").write_text("\n".join(json.dumps(frame) for frame in frames))
    found = list(replayed(tmp_path / "face.jsonl"))
    assert [said.weights["jawOpen"] for _, said in found] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert "_neutral" not in found[0][1].weights
    assert found[4][1].head == pytest.approx([0, np.arctan2(0.6, 0.8), 0]), "about +y: to the person's left"
    with pytest.raises(InputError):
        Landmarks.of({"weights": 3}, "x")


class Film:
    """A film of a few pictures, and cv2 as far as a webcam needs it; the landmarker finds a face in all but the first."""

    CAP_PROP_FPS, COLOR_BGR2RGB = 5, 4

    def __init__(self, pictures, rate):
        self.pictures, self.rate, self.times = iter(range(pictures)), rate, []

    def VideoCapture(self, camera):
        self.camera = camera
        return self

    def isOpened(self):
        return True

    def get(self, number):
        return self.rate

    def read(self):
        self.times.append(time.monotonic())
        picture = next(self.pictures, None)
        return picture is not None, picture

    def cvtColor(self, picture, conversion):
        return picture

    def release(self):
        self.pictures = iter(())

    def landmarker(self):
        """mediapipe, likewise."""
        shapes = [[SimpleNamespace(category_name="jawOpen", score=0.5)]]
        face = SimpleNamespace(face_blendshapes=shapes, facial_transformation_matrixes=[np.eye(4)])
        nobody = SimpleNamespace(face_blendshapes=[])
        found = SimpleNamespace(detect_for_video=lambda image, at: face if image.data else nobody, close=lambda: None)
        vision = SimpleNamespace(
            FaceLandmarkerOptions=lambda *args, **kwargs: None, RunningMode=SimpleNamespace(VIDEO=1),
            FaceLandmarker=SimpleNamespace(create_from_options=lambda options: found),
        )  # fmt: skip
        return SimpleNamespace(
            Image=lambda image_format, data: SimpleNamespace(data=data), ImageFormat=SimpleNamespace(SRGB=1),
            tasks=SimpleNamespace(vision=vision, BaseOptions=lambda model_asset_path: None),
        )  # fmt: skip


def test_a_film_is_watched_in_its_own_time(monkeypatch, tmp_path):
    film, woken = Film(6, 50.0), []
    monkeypatch.setitem(sys.modules, "cv2", film)
    monkeypatch.setitem(sys.modules, "mediapipe", film.landmarker())
    (tmp_path / "model.task").write_bytes(b"a model")
    webcam = Webcam(str(tmp_path / "model.task"), "face.mp4", lambda: woken.append(1))
    wait(lambda: len(film.times) == 7)
    received, _ = webcam.latest()
    assert received.weights["jawOpen"] == 0.5
    assert (webcam.where, film.camera, webcam.counts.received, webcam.counts.malformed, len(woken)) == (
        "face.mp4", "face.mp4", 6, 1, 5,
    )  # fmt: skip
    assert film.times[-1] - film.times[0] > 5 / 50, "not as fast as it can be read"
    webcam.close()


def test_recorded_landmarks_are_played_in_their_time_over_and_over(tmp_path):
    lines = [{"time": 0.02 * k, "weights": {"jawOpen": k / 10}, "matrix": np.eye(4).tolist()} for k in range(3)]
    (tmp_path / "face.jsonl").write_text("\n".join(json.dumps(line) for line in lines))
    seen, begun, playing = [], time.monotonic(), []
    replay = Replay(
        str(tmp_path / "face.jsonl"), lambda: seen.extend(each.latest()[0].weights["jawOpen"] for each in playing)
    )
    playing.append(replay)
    wait(lambda: len(seen) >= 7)
    assert time.monotonic() - begun > 0.1
    replay.close()
    lines = [round(10 * value) for value in seen]
    assert [after for _, after in pairwise(lines)] == [(before + 1) % 3 for before in lines[:-1]]
    assert (replay.where, replay.counts.rate) == ("face.jsonl", 41)
    played = len(seen)
    time.sleep(0.1)
    assert len(seen) == played
    (tmp_path / "none.jsonl").write_text("\n")
    with pytest.raises(InputError, match="a line of recorded landmarks or more"):
        Replay(str(tmp_path / "none.jsonl"))
