"""A zip of other sources: every file in it that is one is read, the others are named."""

from __future__ import annotations

import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

from yieldmon.errors import InputError, brief
from yieldmon.field.table import HarvestTable, Skipped, joined

from .damage import ZIP_DAMAGE
from .options import ReadOptions

KIND = "zip of harvests"
ORDER = 90
MAX_BYTES = 4 << 30


def recognises(path: Path, head: bytes) -> bool:
    """Any zip that no other source has taken."""
    return path.is_file() and (head.startswith(b"PK\x03\x04") or zipfile.is_zipfile(path))


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """The harvests in it one after another. Raises InputError where there is none."""
    from . import read as read_any

    tables, skipped = [], []
    with tempfile.TemporaryDirectory() as folder:
        try:
            with zipfile.ZipFile(path) as archive:
                members = [info for info in archive.infolist() if not info.is_dir()]
        except ZIP_DAMAGE as error:
            raise InputError(str(path), f"is a damaged zip: {brief(error)}", "a zip") from error
        if sum(info.file_size for info in members) > MAX_BYTES:
            raise InputError(str(path), f"unpacks to more than {MAX_BYTES} bytes", "a smaller zip")
        for number, info in enumerate(members):
            name = info.filename.replace("\\", "/").rsplit("/", 1)[-1]
            place = Path(folder) / f"{number}" / (name or "member")
            place.parent.mkdir()
            try:
                with zipfile.ZipFile(path) as archive:
                    place.write_bytes(archive.read(info))
                if zipfile.is_zipfile(place):
                    raise InputError(name, "is a zip within a zip", "one zip")
                tables.append(read_any(place, options))
            except InputError as error:
                skipped.append(Skipped(brief(info.filename), error.problem))
            except ZIP_DAMAGE as error:
                skipped.append(Skipped(brief(info.filename), f"cannot be unpacked: {brief(error)}"))
    if not tables:
        reasons = "; ".join(f"{one.part}: {one.why}" for one in skipped[:3]) or "it is empty"
        raise InputError(str(path), f"holds no harvest ({reasons})", "a zip with one")
    table = joined(tables)
    sources = tuple(
        replace(source, path=f"{path}: {Path(source.path).name}", skipped=(*source.skipped, *(skipped if number == 0 else ())))
        for number, source in enumerate(table.sources)
    )
    return replace(table, sources=sources)
