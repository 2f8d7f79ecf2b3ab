"""A folder or a zip of other sources: every file in it that is one is read, also in folders and zips within.

Those that are none are named.
"""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError, brief, of_the_computer, reason
from yieldmon.field.table import HarvestTable, Skipped, joined
from yieldmon.files.delimited import WORKBOOK

from . import isoxml, vector
from .damage import ZIP_DAMAGE
from .options import ReadOptions

KIND = "zip or folder of harvests"
ORDER = 90
MAX_BYTES = 4 << 30
MAX_FILES = 2_000
MAX_DEPTH = 8
_LONGEST_NAME = 100


def recognises(path: Path, head: bytes) -> bool:
    """Any zip or folder that no other source has taken."""
    return path.is_dir() or head.startswith(b"PK\x03\x04") or zipfile.is_zipfile(path)


def read(path: Path, options: ReadOptions) -> HarvestTable:
    """The harvests in it one after another. Raises InputError where there is none."""
    with tempfile.TemporaryDirectory() as scratch:
        found = _Found(Path(scratch))
        found.look(path, "")
        tables, skipped = [], list(found.skipped)
        for one in found.parts:
            try:
                tables.append((one.name, _read(one, options)))
            except InputError as error:
                if of_the_computer(error) is not None:
                    raise
                skipped.append(Skipped(brief(one.name), error.problem))
    if not tables:
        reasons = "; ".join(f"{one.part}: {one.why}" for one in skipped[:3]) or "it is empty"
        raise InputError(str(path), f"holds no harvest ({reasons})", f"a {'folder' if path.is_dir() else 'zip'} with one")
    table = joined([_named(table, f"{path}: {name}") for name, table in tables])
    return table.noting(skipped=skipped)


def _named(table: HarvestTable, path: str) -> HarvestTable:
    return replace(table, sources=tuple(replace(source, path=path) for source in table.sources))


def _read(part: _Part, options: ReadOptions) -> HarvestTable:
    from . import read as read_any

    module = part.reader
    table: HarvestTable = read_any(part.place, options) if module is None else module.read(part.place, options)
    return table


@dataclass(frozen=True)
class _Part:
    """name: within the folder or zip. reader: a module, or None for whichever recognises it."""

    name: str
    place: Path
    reader: Any


class _Found:
    """Parts of folders and zips that may be harvests, in the order of their names."""

    def __init__(self, scratch: Path) -> None:
        self.parts: list[_Part] = []
        self.skipped: list[Skipped] = []
        self._scratch, self._zips, self._bytes, self._files = scratch, 0, 0, 0

    def look(self, path: Path, name: str, depth: int = 0) -> None:
        """Into a folder or a zip, which is unpacked."""
        if depth > MAX_DEPTH:
            self.skipped.append(Skipped(brief(name), f"is nested more than {MAX_DEPTH} folders or zips deep"))
        elif path.is_dir():
            self._folder(path, name, depth)
        else:
            self._folder(self._unpacked(path, name), name, depth)

    def _folder(self, folder: Path, name: str, depth: int) -> None:
        children = sorted(child for child in folder.iterdir() if not child.name.startswith("._"))
        self._files += len(children)
        if self._files > MAX_FILES:
            raise InputError(name or str(folder), f"holds more than {MAX_FILES} files", "a folder of harvests")
        files = [child for child in children if child.is_file()]
        taken: set[Path] = set()
        if any(isoxml.is_task_member(child.name) for child in files):
            self.parts.append(_Part(name or folder.name, folder, isoxml))
            taken |= {child for child in files if isoxml.is_task_part(child.name)}
        for shape in [child for child in files if child.suffix.lower() == ".shp"]:
            self.parts.append(_Part(_joined(name, shape.name), shape, vector))
            taken |= {child for child in files if vector.is_beside(child.name, shape.name)}
        for child in children:
            inside = _joined(name, child.name)
            if child in taken or child.name == "__MACOSX":
                continue
            if child.is_dir() and not child.is_symlink():
                self._folder_within(child, inside, depth)
            elif child.is_file():
                self._file(child, inside, depth)

    def _folder_within(self, folder: Path, name: str, depth: int) -> None:
        try:
            self.look(folder, name, depth + 1)
        except OSError as error:
            if of_the_computer(error) is not None:
                raise
            self.skipped.append(Skipped(brief(name), reason(error)))

    def _file(self, path: Path, name: str, depth: int) -> None:
        try:
            if zipfile.is_zipfile(path) and path.suffix.lower() != WORKBOOK:
                self.look(path, name, depth + 1)
            else:
                self.parts.append(_Part(name, path, None))
        except InputError as error:
            self.skipped.append(Skipped(brief(name), error.problem))

    def _unpacked(self, path: Path, name: str) -> Path:
        """Its files under names that every system takes. Raises InputError for a damaged one."""
        self._zips += 1
        home = self._scratch / str(self._zips)
        home.mkdir()
        try:
            with zipfile.ZipFile(path) as archive:
                members = [info for info in archive.infolist() if not info.is_dir()]
                self._bytes += sum(info.file_size for info in members)
                if self._bytes > MAX_BYTES:
                    raise InputError(name or str(path), f"unpacks to more than {MAX_BYTES} bytes", "a smaller zip")
                if len(members) > MAX_FILES:
                    raise InputError(name or str(path), f"holds more than {MAX_FILES} files", "a zip of harvests")
                for number, info in enumerate(members):
                    self._unpack(archive, info, home, number, name)
        except ZIP_DAMAGE as error:
            if of_the_computer(error) is not None:
                raise
            raise InputError(name or str(path), f"is a damaged zip: {brief(error)}", "a zip") from error
        return home

    def _unpack(self, archive: zipfile.ZipFile, info: zipfile.ZipInfo, home: Path, number: int, name: str) -> None:
        parts = list(_safe_parts(info.filename)) or ["member"]
        place = home.joinpath(*parts)
        try:
            data = archive.read(info)
            place.parent.mkdir(parents=True, exist_ok=True)
            if place.exists():
                place = place.with_name(f"{number} {place.name}"[:_LONGEST_NAME])
            place.write_bytes(data)
        except ZIP_DAMAGE as error:
            if of_the_computer(error) is not None:
                raise
            self.skipped.append(Skipped(brief(_joined(name, info.filename)), f"cannot be unpacked: {brief(error)}"))


def _joined(folder: str, name: str) -> str:
    return f"{folder}/{name}" if folder else name


def _safe_parts(name: str) -> Iterator[str]:
    """Parts of a member's path that can be made below a folder, and nowhere else."""
    for part in name.replace("\\", "/").split("/"):
        plain = "".join(letter for letter in part if letter.isprintable() and letter not in ':*?"<>|').strip()
        if plain.strip("."):
            stem, suffix = os.path.splitext(plain)
            yield stem[: _LONGEST_NAME - len(suffix[:10])] + suffix[:10]
