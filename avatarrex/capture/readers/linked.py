"""A capture's file under another name: a hard link where the disk allows it, else a copy."""

from __future__ import annotations

import os
from pathlib import Path

from avatarrex.capture.readers.archive import Archive
from avatarrex.files.gate import written


def link(archive: Archive, name: str, target: Path) -> None:
    """The file `name` of the archive as `target`; what is there already is left."""
    if target.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    source = archive.path / name
    try:
        os.link(source.resolve(), target)
    except OSError:  # a zip, another disk, or a file system without links
        with written(target) as part:
            part.write_bytes(archive.read(name))
