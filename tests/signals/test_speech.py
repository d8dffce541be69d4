"""Sound to a mouth: what is loud opens it, the spectrum chooses the shape, silence leaves it shut."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest

from avatarrex.errors import InputError
from avatarrex.signals.joints import EXPRESSION_NAMES
from avatarrex.signals.read import import_motion

RATE = 16000


def write(path: Path, samples: np.ndarray, width: int = 2) -> Path:
    """Mono, 8 to 32 bits."""
    whole = np.round(np.clip(samples, -1, 1) * (2 ** (8 * width - 1) - 1)).astype(np.int64)
    data = (
        (whole + 128).astype(np.uint8).tobytes()
        if width == 1
        else b"".join(int(v).to_bytes(width, "little", signed=True) for v in whole)
    )
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(width)
        file.setframerate(RATE)
        file.writeframes(data)
    return path


def band(low: float, high: float, seconds: float) -> np.ndarray:
    """Noise of one band, with an amplitude of about 0.3."""
    spectrum = np.fft.rfft(np.random.default_rng(0).standard_normal(int(seconds * RATE)))
    frequencies = np.fft.rfftfreq(int(seconds * RATE), 1 / RATE)
    spectrum[(frequencies < low) | (frequencies > high)] = 0
    samples = np.fft.irfft(spectrum)
    return 0.3 * samples / np.abs(samples).max()


def vowel(formants: tuple[float, float], seconds: float) -> np.ndarray:
    """Harmonics of 120 Hz about two formants, the second at half the level."""
    time = np.arange(int(seconds * RATE)) / RATE
    tones = [
        sum(level * np.exp(-(((120 * k - f) / 120) ** 2)) for f, level in zip(formants, (1.0, 0.5)))
        * np.sin(2 * np.pi * 120 * k * time)
        for k in range(1, 30)
    ]
    samples = np.sum(tones, axis=0)
    return 0.4 * samples / np.abs(samples).max()


def mouth(path: Path) -> dict[str, np.ndarray]:
    frames = import_motion(path).sequence
    assert frames.fps == 60
    values = np.stack([frame.expression for frame in frames])
    return {name: values[:, k] for k, name in enumerate(EXPRESSION_NAMES)}


def test_loud_parts_open_the_mouth_and_silence_shuts_it(tmp_path: Path) -> None:
    silence = np.zeros(RATE // 2)
    said = mouth(write(tmp_path / "a.wav", np.concatenate([silence, vowel((700.0, 1200.0), 0.5), silence])))
    assert said["jawOpen"][40] > 0.3
    assert said["jawOpen"][[5, 85]].max() < 0.05
    moved = {name for name, values in said.items() if values.any()}
    assert all(name.startswith(("jaw", "mouth", "tongue", "cheekPuff")) for name in moved)


def test_the_spectrum_chooses_the_shape(tmp_path: Path) -> None:
    silence = np.zeros(RATE // 4)
    sounds = {
        "ah": vowel((730.0, 1100.0), 0.4),
        "ee": vowel((280.0, 2300.0), 0.4),
        "oo": vowel((350.0, 600.0), 0.4),
        "s": band(4500, 7500, 0.4),
    }
    said = {
        name: {
            key: values[27]
            for key, values in mouth(write(tmp_path / f"{name}.wav", np.concatenate([silence, sound, silence]))).items()
        }
        for name, sound in sounds.items()
    }
    assert max(said, key=lambda name: said[name]["jawOpen"]) == "ah"
    assert max(said, key=lambda name: said[name]["mouthSmileLeft"]) == "ee"
    assert max(said, key=lambda name: said[name]["mouthFunnel"]) == "oo"
    assert said["s"]["jawOpen"] < 0.5 * said["ah"]["jawOpen"]


@pytest.mark.parametrize("width", [1, 3, 4])
def test_other_widths_say_the_same(tmp_path: Path, width: int) -> None:
    sound = np.concatenate([np.zeros(4000), vowel((700.0, 1200.0), 0.3)])
    as_16 = mouth(write(tmp_path / "a.wav", sound))["jawOpen"]
    assert mouth(write(tmp_path / "b.wav", sound, width))["jawOpen"] == pytest.approx(as_16, abs=0.05)


@pytest.mark.parametrize("content", [b"", b"RIFF", b"RIFF\x10\x00\x00\x00WAVEfmt \x00\x00\x00\x00", b"no sound at all"])
def test_no_sound_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.wav").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.wav"):
        import_motion(tmp_path / "a.wav")
