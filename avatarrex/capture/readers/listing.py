"""Which pictures a rig has: images with their mattes by camera and frame, and what is missing of them."""

from __future__ import annotations

from avatarrex.capture.readers.archive import Archive
from avatarrex.capture.readers.calibration import Lens
from avatarrex.capture.readers.images_store import has_alpha
from avatarrex.capture.readers.layout import RigFiles
from avatarrex.errors import InputError


def with_pictures(
    name: str, files: RigFiles, lenses: tuple[Lens, ...], count: int, notes: list[str]
) -> tuple[tuple[Lens, ...], tuple[dict[int, str], ...], tuple[dict[int, str], ...]]:
    """The cameras that have any picture, with their images and mattes by frame."""
    images = {lens.name: files.pictures(lens.name) for lens in lenses}
    mattes = {lens.name: files.mattes(lens.name) for lens in lenses}
    own = [lens.name for lens in lenses if _take_alpha(files.archive, images[lens.name], mattes[lens.name])]
    if own:
        notes.append(f"{name}: pictures of {len(own)} of {len(lenses)} cameras are their own mattes (alpha channel)")
    kept = tuple(lens for lens in lenses if set(images[lens.name]) & set(mattes[lens.name]) & set(range(count)))
    if not kept:
        raise InputError(
            files.archive.place(files.folder), "", f"images with mattes of cameras {lenses[0].name}, …", "none"
        )
    for lens in lenses:
        if lens not in kept:
            part = "no mattes" if images[lens.name] else "no images"
            notes.append(f"{name}: camera {lens.name} has {part}: left out")
    beyond = max((frame for lens in kept for frame in images[lens.name]), default=0) + 1 - count
    if beyond > 0:
        notes.append(f"{name}: images of {beyond} frames beyond the parameters' {count} are not used")
    return kept, tuple(images[lens.name] for lens in kept), tuple(mattes[lens.name] for lens in kept)


def _take_alpha(archive: Archive, images: dict[int, str], mattes: dict[int, str]) -> bool:
    """Whether pictures without a matte have an alpha channel, by the first of them; they are then added to `mattes`."""
    bare = {frame: image for frame, image in images.items() if frame not in mattes}
    found = bool(bare) and has_alpha(archive, bare[min(bare)])
    if found:
        mattes |= bare
    return found


def missing_pictures(
    name: str,
    images: tuple[dict[int, str], ...],
    mattes: tuple[dict[int, str], ...],
    listed: frozenset[tuple[int, int]],
    count: int,
    notes: list[str],
) -> frozenset[tuple[int, int]]:
    """(view, frame) that are listed as missing, or lack an image or a matte."""
    listed = frozenset((view, frame) for view, frame in listed if frame < count)
    absent = {
        (view, frame)
        for view in range(len(images))
        for frame in range(count)
        if frame not in images[view] or frame not in mattes[view]
    }
    if listed:
        notes.append(f"{name}: {len(listed)} pictures listed as missing")
    if absent - listed:
        notes.append(f"{name}: {len(absent - listed)} of {len(images) * count} pictures are not there")
    return frozenset(absent | listed)
