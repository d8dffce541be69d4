"""The Timeline and live sources through the real window, driven like a user would."""

from __future__ import annotations

import json
import socket
import time

import driving
import numpy as np
import pytest
from avatarrex_studio.live import livelink_packet
from avatarrex_studio.panels.keys import chord
from avatarrex_studio.panels.lanes import ROW
from avatarrex_studio.session.journal import Journal
from ball import ball_engine
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui
from test_live_sources import VMC
from test_window import drive, rest

from avatarrex.signals.joints import EXPRESSION_NAMES

pytestmark = [pytest.mark.window, pytest.mark.slow]
JAW = EXPRESSION_NAMES.index("jawOpen")
PACKETS = {
    "Live Link Face": livelink_packet.encode({"jawOpen": 0.6}),
    "iFacialMocap": b"jawOpen-60|=head#0,0,0,0,0,0|",
    "OSC / VMC": VMC,
}


def arrived(signals):
    """Whether the smoothing is through with what the packets say."""
    return abs(signals.expression[JAW] - 0.6) < 0.02 or abs(signals.body_pose[17, 1] + 0.5) < 0.02


class Rows:
    """Where things are in the Timeline, points."""

    def __init__(self, test, window):
        self.test, self.window = test, window

    def x(self, seconds):
        return self.window.timeline.lanes._scale.x(seconds)

    def y(self, row):
        low = self.test.item_info("//Timeline/ruler").rect_full.max.y
        return low + imgui.get_style().item_spacing.y + ROW * (row + 0.45)

    def drag(self, start, end):
        test = self.test
        test.mouse_move_to_pos(imgui.ImVec2(*start))
        test.mouse_down()
        for k in range(1, 5):
            test.mouse_teleport_to_pos(imgui.ImVec2(*(a + (b - a) * k / 4 for a, b in zip(start, end))))
            test.yield_()
        test.mouse_up()
        test.yield_(2)


def test_play_scrub_keys_and_layers(display, tmp_path):
    seen = {}

    def scenario(test, window):
        studio, rows = window.studio, Rows(test, window)
        rest(test, window)
        test.item_click(f"//Timeline/{icons.ICON_FA_PERSON_WALKING}  Motions##motion.own")
        test.yield_(2)
        test.item_click("//$FOCUSED/Walk: walks in place")
        test.yield_(3)
        seen["field"] = window.timeline._path[1]
        test.key_press(chord("Space"))
        until = time.monotonic() + 0.8
        while time.monotonic() < until:
            test.yield_()
        test.key_press(chord("Space"))
        test.yield_(2)
        seen["played"], seen["steps"] = studio.state.timeline.frame, len(studio.journal.steps)
        ruler = test.item_info("//Timeline/ruler").rect_full.get_center().y
        rows.drag((rows.x(0.2), ruler), (rows.x(1.0), ruler))
        seen["scrubbed"] = studio.state.timeline.frame
        # two keys, set by K; the second is dragged half a second on
        rows.drag((rows.x(0.5), ruler), (rows.x(0.0), ruler))
        test.window_focus("//Face")
        test.item_input_value("//Face/##jawOpen", 0.2)
        test.key_press(chord("K"))
        rows.drag((rows.x(0.2), ruler), (rows.x(1.0), ruler))
        test.item_input_value("//Face/##jawOpen", 0.8)
        test.key_press(chord("K"))
        test.yield_(3)
        seen["keys"] = [key.time for key in studio.state.timeline.layer("Keys").track("jawOpen").keys]
        rows.drag((rows.x(1.0), rows.y(0)), (rows.x(1.5), rows.y(0)))
        seen["moved"] = [key.time for key in studio.state.timeline.layer("Keys").track("jawOpen").keys]
        seen["one step"] = len(studio.journal.steps)
        test.key_press(chord("Ctrl+Z"))
        test.yield_(2)
        seen["undone"] = [key.time for key in studio.state.timeline.layer("Keys").track("jawOpen").keys]
        test.key_press(chord("Ctrl+Shift+Z"))
        test.yield_(2)
        test.mouse_move_to_pos(imgui.ImVec2(rows.x(1.5), rows.y(0)))
        test.mouse_click(imgui.MouseButton_.left)
        test.key_press(int(imgui.Key.delete))
        test.yield_(3)
        seen["deleted"] = [key.time for key in studio.state.timeline.layer("Keys").track("jawOpen").keys]
        # the walk's layer is muted by its eye, and dragged to begin later
        place = window.timeline.lanes._scale.left - 12
        test.mouse_move_to_pos(imgui.ImVec2(place, rows.y(1)))
        test.mouse_click(imgui.MouseButton_.left)
        test.yield_(2)
        seen["muted"] = studio.state.timeline.layer("walk").muted
        test.mouse_click(imgui.MouseButton_.left)
        test.yield_(2)
        rows.drag((rows.x(0.4), rows.y(1)), (rows.x(0.6), rows.y(1)))
        seen["offset"] = studio.state.timeline.layer("walk").offset
        # what is changed while it records becomes keys
        test.item_click(f"//Timeline/{icons.ICON_FA_CIRCLE}##record")
        test.key_press(chord("Space"))
        for k in range(6):
            test.item_input_value("//Face/##browInnerUp", 0.1 + 0.1 * k)
            test.yield_(4)
        test.key_press(chord("Space"))
        test.item_click(f"//Timeline/{icons.ICON_FA_CIRCLE}##record")
        test.yield_(3)
        track = studio.state.timeline.layer("Keys").track("browInnerUp")
        seen["recorded"] = track and len(track.keys)
        test.key_press(chord("G"))
        test.yield_(3)
        test.key_chars_replace("12")
        test.key_press(int(imgui.Key.enter))
        test.yield_(3)
        seen["gone to"] = studio.state.timeline.frame
        studio.save_session(str(tmp_path / "s.json"))
        rest(test, window)
        seen["state"] = studio.state

    drive(ball_engine, scenario)
    assert seen["field"] == "walk", "the field names the motion that is loaded"
    assert 8 <= seen["played"] <= 60
    assert seen["steps"] == 2
    assert seen["scrubbed"] == 30
    assert seen["keys"] == pytest.approx([0.0, 1.0])
    assert seen["moved"] == pytest.approx([0.0, 1.5], abs=0.02)
    assert seen["undone"] == pytest.approx([0.0, 1.0])
    assert seen["deleted"] == pytest.approx([0.0])
    assert seen["muted"]
    assert seen["offset"] == pytest.approx(0.2, abs=0.04)
    assert seen["recorded"] >= 3
    assert seen["gone to"] == 12
    again = Journal.load(tmp_path / "s.json").state
    engine = ball_engine()
    first, second = (engine.render(state, (48, 36)).frame.image.numpy() for state in (seen["state"], again))
    assert np.abs(first - second).max() <= 1 / 255


def test_live_packets_drive_the_avatar_and_are_recorded(display):
    seen = {}

    def scenario(test, window):
        studio = window.studio
        rest(test, window)
        for title, packet in PACKETS.items():
            test.item_click(f"//Timeline/{icons.ICON_FA_PLUS}  Layer##layer.add")
            test.yield_(2)
            test.item_click("//$FOCUSED/Live: " + title.replace("/", "\\/"))
            test.yield_(4)
            seen[title, "silent"] = studio.listening.words
            window.timeline.menu.live._places[title] = ("127.0.0.1", 0)
            test.item_click("//$FOCUSED/###live.switch")
            test.yield_(3)
            port = studio.listening.drives[title].sender.port
            until = time.monotonic() + 30
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                while not arrived(studio.state.signals) and time.monotonic() < until:
                    sender.sendto(packet, ("127.0.0.1", port))
                    sender.sendto(b"\xff\x00nonsense", ("127.0.0.1", port))
                    test.yield_()
                seen[title] = studio.state.signals
                seen[title, "words"] = studio.listening.words
                if title == "Live Link Face":
                    test.item_click("//$FOCUSED/###live.record")
                    for _ in range(40):
                        sender.sendto(packet, ("127.0.0.1", port))
                        test.yield_()
                    test.item_click("//$FOCUSED/###live.record")
                    test.yield_(3)
                    seen["clip"] = studio.state.timeline.layers[-1]
            test.item_click("//$FOCUSED/###live.switch")
            test.key_press(int(imgui.Key.escape))
            test.yield_(3)
            seen[title, "off"] = studio.listening.words
            for _ in range(8):
                studio.undo()

    drive(ball_engine, scenario)
    for title in ("Live Link Face", "iFacialMocap"):
        assert seen[title].expression[JAW] == pytest.approx(0.6, abs=0.02)
    assert seen["OSC / VMC"].body_pose[17] == pytest.approx([0, -0.5, 0], abs=0.02)
    for title in PACKETS:
        assert seen[title, "silent"] == seen[title, "off"] == ""
        assert "listening at 127.0.0.1:" in seen[title, "words"]
        assert "malformed" in seen[title, "words"]
    assert seen["clip"].clip.frames > 5
    assert seen["clip"].clip.path.endswith(".json")


def test_recorded_landmarks_drive_a_webcam_layer(display, tmp_path):
    """No landmark model comes with the program: what a landmarker found is played from a file, switched on, recorded, switched off."""
    seen = {}
    lines = [{"time": k / 30, "weights": {"jawOpen": 0.6}, "matrix": np.eye(4).tolist()} for k in range(10)]
    (tmp_path / "face.jsonl").write_text("\n".join(map(json.dumps, lines)))

    def scenario(test, window):
        studio = window.studio
        rest(test, window)
        test.item_click(f"//Timeline/{icons.ICON_FA_PLUS}  Layer##layer.add")
        test.yield_(2)
        test.item_click("//$FOCUSED/Live: Webcam")
        test.yield_(4)
        test.item_click("//$FOCUSED/##live.camera")
        test.key_chars_replace(str(tmp_path / "none.jsonl"))
        test.item_click("//$FOCUSED/###live.switch")
        test.yield_(3)
        seen["refused"] = dict(studio.listening.drives)
        test.item_click("//$FOCUSED/##live.camera")
        test.key_chars_replace(str(tmp_path / "face.jsonl"))
        test.item_click("//$FOCUSED/###live.switch")
        driving.until(test, lambda: arrived(studio.state.signals))
        seen["driven"], seen["words"] = studio.state.signals, studio.listening.words
        test.item_click("//$FOCUSED/###live.record")
        test.yield_(40)
        test.item_click("//$FOCUSED/###live.record")
        test.yield_(3)
        seen["clip"] = studio.state.timeline.layers[-1].clip
        test.item_click("//$FOCUSED/###live.switch")
        test.yield_(3)
        seen["off"] = studio.listening.words

    window = drive(ball_engine, scenario)
    assert seen["refused"] == {}
    assert any("none.jsonl" in line for _, line in window.console.lines), "what is missing is said"
    assert seen["driven"].expression[JAW] == pytest.approx(0.6, abs=0.02)
    assert "face.jsonl (" in seen["words"]
    assert seen["clip"].frames > 5
    assert seen["off"] == ""
