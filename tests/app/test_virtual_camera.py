"""The virtual camera, with a stand-in for the package that talks to the system: what it is sent, and what is said without a device."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from avatarrex_studio.window.output import VirtualCamera


class Device:
    """What pyvirtualcam.Camera does."""

    opened: list[Device]

    def __init__(self, width, height, fps):
        if width > 1000:
            raise RuntimeError("no device\nand more")
        self.width, self.height, self.device, self.sent, self.closed = width, height, "test", [], False
        self.opened.append(self)

    def send(self, frame):
        assert frame.shape == (self.height, self.width, 3)
        self.sent.append(frame)

    def close(self):
        self.closed = True


@pytest.fixture
def devices(monkeypatch):
    Device.opened = []
    monkeypatch.setitem(sys.modules, "pyvirtualcam", SimpleNamespace(Camera=Device))
    return Device.opened


def picture(width, height):
    return np.full((height, width, 4), (200, 100, 0, 128), np.uint8)


def test_pictures_are_sent_over_black_with_even_sides(devices):
    camera = VirtualCamera()
    camera.toggle()
    assert camera.running
    camera.send(picture(7, 5))
    camera.send(picture(7, 5))
    camera.send(picture(8, 6))
    camera.toggle()
    first, second = devices
    assert [(len(device.sent), device.closed) for device in devices] == [(2, True), (1, True)]
    assert (first.width, first.height, second.width, second.height) == (6, 4, 8, 6)
    assert first.sent[0][0, 0].tolist() == [100, 50, 0]
    assert not camera.running


def test_without_a_device_it_is_said_and_stops(devices, caplog):
    camera = VirtualCamera()
    camera.toggle()
    camera.send(picture(2000, 10))
    assert not camera.running
    assert "no device. On Linux" in caplog.text


def test_without_the_package_it_is_said(monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "pyvirtualcam", None)
    camera = VirtualCamera()
    camera.toggle()
    assert not camera.running
    assert "pip install 'avatarrex-studio[camera]'" in caplog.text
