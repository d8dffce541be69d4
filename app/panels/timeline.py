"""The Timeline: play a motion at its own rate, scrub, step, loop; the motions that come with the program."""

from __future__ import annotations

from avatarrex_studio.engine.studio import Studio
from avatarrex_studio.panels import widgets
from avatarrex_studio.panels.files import FileDialog
from avatarrex_studio.panels.motion_import import MotionImport
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from avatarrex.signals.own_motions import MOTIONS


class TimelinePanel:
    """Playback of the loaded motion, how it was read, and the path of the next."""

    def __init__(self) -> None:
        self.path = ""
        self.reading, self.files = MotionImport(), FileDialog()

    def draw(self, studio: Studio) -> int | None:
        """Draw the panel; the frame that was scrubbed to, if any."""
        motion = studio.state.motion
        wanted = self._transport(studio) if motion else None
        if motion is None:
            imgui.align_text_to_frame_padding()
            widgets.caption(
                "No motion: choose one of the program's, or open a .bvh, .amc, .fbx, .npz, .npy, .csv or .json file"
            )
        self._own(studio)
        imgui.same_line()
        imgui.set_next_item_width(max(widgets.room() - 92, 80))
        entered, self.path = imgui.input_text_with_hint(
            "##motion.path", "Path of a motion file", self.path, imgui.InputTextFlags_.enter_returns_true
        )
        imgui.same_line()
        loads, path = imgui.button(f"{icons.ICON_FA_FOLDER_OPEN}  Load##motion", (-1, 0)), self.path.strip()
        if path and (loads or entered):
            studio.open_motion(path)
        elif loads:
            self.files.open("motion", "Open a motion", studio.open_motion)
        self.files.draw()
        return wanted

    def _own(self, studio: Studio) -> None:
        """The menu of motions, and how the loaded one was read."""
        if imgui.button(f"{icons.ICON_FA_PERSON_WALKING}  Motions##motion.own"):
            imgui.open_popup("motions")
        if imgui.begin_popup("motions"):
            for name, what in MOTIONS.items():
                if imgui.menu_item(f"{name.capitalize()}: {what}", "", False)[0]:
                    studio.open_motion(name)
            imgui.separator()
            if imgui.menu_item("How the motion was read…", "", False, studio.state.motion is not None)[0]:
                self.reading.open()
            imgui.end_popup()
        motion = studio.playback.current(studio.state)
        if motion and motion.imported.warnings:
            imgui.same_line()
            if imgui.button(f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}##motion.warnings"):
                self.reading.open()
            widgets.tooltip("\n".join(motion.imported.warnings))

    def _transport(self, studio: Studio) -> int | None:
        motion = studio.state.motion
        assert motion is not None
        wanted = None
        square = (32, 0)
        if imgui.button(f"{icons.ICON_FA_BACKWARD_STEP}##back", square):
            wanted = motion.frame - 1
        imgui.same_line(0, 4)
        if imgui.button(f"{icons.ICON_FA_PAUSE if studio.playback.playing else icons.ICON_FA_PLAY}###play", square):
            studio.toggle_play()
        imgui.same_line(0, 4)
        if imgui.button(f"{icons.ICON_FA_FORWARD_STEP}##on", square):
            wanted = motion.frame + 1
        imgui.same_line()
        _, studio.playback.loop = imgui.checkbox("Loop", studio.playback.loop)
        imgui.same_line()
        seconds = f"{motion.frame / motion.fps:.2f} / {(motion.frames - 1) / motion.fps:.2f} s   {motion.fps:g} fps"
        imgui.set_next_item_width(max(widgets.room() - imgui.calc_text_size(seconds).x - 12, 60))
        moved, frame = imgui.slider_int("##frame", motion.frame, 0, motion.frames - 1)
        imgui.same_line()
        widgets.caption(seconds)
        return frame if moved else wanted
