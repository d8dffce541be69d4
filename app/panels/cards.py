"""Library entries as cards: a picture with its name. Textures of the window's context are made between two interface frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import moderngl
from avatarrex_studio.engine.thumbnails import Sitter, Thumbnails
from avatarrex_studio.panels import theme, widgets
from avatarrex_studio.panels.texture import uploaded
from imgui_bundle import imgui

from avatarrex.avatar import Avatar

SMALLEST, GAP = 84.0, 6.0
"""Points of a card's width at least, and between two."""


@dataclass(frozen=True)
class Card:
    """One entry: `name` is its id, `title` what is under its picture."""

    name: str
    title: str
    sitter: Sitter


class Cards:
    """Draws cards with what there is of their pictures."""

    def __init__(self, thumbnails: Thumbnails | None = None) -> None:
        self.thumbnails = thumbnails or Thumbnails()
        self._textures: dict[Sitter, moderngl.Texture] = {}
        self._drawn = False

    def draw(self, cards: Iterable[Card], key: str, chosen: str | None) -> tuple[str | None, str | None]:
        """The name of the card that was clicked, and of the one under the right button. `key` begins their ids."""
        clicked = menu = None
        self._drawn = True
        number, width = widgets.columns(SMALLEST, GAP)
        for card in widgets.in_rows(cards, GAP, number):
            if imgui.invisible_button(
                f"{card.title}##{key}{card.name}", (width, width + imgui.get_text_line_height() + 4)
            ):
                clicked = card.name
            if imgui.is_item_clicked(imgui.MouseButton_.right):
                menu = card.name
            if imgui.is_item_visible():
                self._face(card, width, card.name == chosen)
            widgets.tooltip(card.title)
        return clicked, menu

    def _face(self, card: Card, width: float, chosen: bool) -> None:
        """The last item as a card."""
        draw, low = imgui.get_window_draw_list(), imgui.get_item_rect_min()
        high = (low.x + width, low.y + width)
        draw.add_rect_filled(low, high, theme.colour(theme.RAISED if imgui.is_item_hovered() else theme.FRAME), 5)
        texture = self._textures.get(card.sitter)
        if texture is None:
            self.thumbnails.want(card.sitter)
        else:
            draw.add_image(imgui.ImTextureRef(texture.glo), low, high)
        if chosen:
            draw.add_rect(low, high, theme.colour(theme.ACCENT), 5, thickness=1.5)
        title = _fitted(card.title, width)
        place = (low.x + (width - imgui.calc_text_size(title).x) / 2, high[1] + 2)
        draw.add_text(place, theme.colour(theme.TEXT if chosen or imgui.is_item_hovered() else theme.MUTED), title)

    def tend(self, context: moderngl.Context, avatar: Avatar | None, idle: bool) -> None:
        """Outside of the interface's frame: forget another avatar's pictures; where nothing else is to be drawn, make one more."""
        if self.thumbnails.see(avatar):
            self.close()
        if not self._drawn:
            self.thumbnails.forget()
        elif idle:
            made = self.thumbnails.tend()
            if made:
                self._textures[made[0]] = uploaded(context, made[1])
        self._drawn = False

    def close(self) -> None:
        """Give the textures back."""
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()
        self.thumbnails.close()

    @property
    def waiting(self) -> bool:
        """Whether cards that are seen have no picture yet."""
        return self.thumbnails.waiting


def _fitted(text: str, width: float) -> str:
    """`text`, shortened to `width` points."""
    if imgui.calc_text_size(text).x <= width:
        return text
    while text and imgui.calc_text_size(text + "…").x > width:
        text = text[:-1]
    return text + "…"
