"""A capture's file under another name: a hard link where the disk allows it, else a copy."""

from __future__ import annotations

import os
from pathlib import Path

from avatarrex.capture.readers.archive import Archive
from avatarrex.files.gate import written


def link(archive: Archive, name: str, target: Path) -> None:
    """The file `name` of the archive as `target`; what is there already is left where it is that file or a copy of it."""
    source = archive.path / name
    packed = archive.path.is_file()
    if target.exists():
        if target.read_bytes() == archive.read(name) if packed else _same(source, target):
            return
        target.unlink()
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:  # a zip, another disk, or a file system without links
        with written(target) as part:
            part.write_bytes(archive.read(name))
            if not packed:
                status = source.stat()
                os.utime(part, ns=(status.st_atime_ns, status.st_mtime_ns))


def _same(source: Path, target: Path) -> bool:
    """Whether both are one file, or of one size and time."""
    one, other = source.stat(), target.stat()
    return os.path.samestat(one, other) or (one.st_size, one.st_mtime_ns) == (other.st_size, other.st_mtime_ns)
