"""The files of a store: what each is called."""

from __future__ import annotations

from pathlib import Path


def parts(path: Path) -> tuple[Path, Path, Path]:
    """The files of a store: itself, its journal and the journal's index."""
    return path, path.with_name(f"{path.name}-wal"), path.with_name(f"{path.name}-shm")


def rollback_path(path: Path) -> Path:
    """SQLite's own journal of a store that is in no write-ahead mode yet."""
    return path.with_name(f"{path.name}-journal")


def commit_note_path(path: Path) -> Path:
    """The note of the last batch that was committed."""
    return path.with_name(f"{path.name}.last")


def lock_path(path: Path) -> Path:
    """The file by which a daemon keeps others off the store."""
    return path.with_name(f"{path.name}.lock")


def being_made_path(path: Path) -> Path:
    """A new store before it is whole."""
    return path.with_name(f"{path.name}.being-made")


def ready_path(path: Path) -> Path:
    """A new store that is whole, before it takes the damaged one's name."""
    return path.with_name(f"{path.name}.ready")


def repaired_path(path: Path) -> Path:
    """A copy of a damaged store with another header or first page, to be read."""
    return path.with_name(f"{path.name}.mended")


def file_state(path: Path) -> tuple[int, int]:
    """When a file was changed last, ns, and its size, bytes: it is another one where these differ. Raises OSError."""
    found = path.stat()
    return found.st_mtime_ns, found.st_size


def beside(path: Path) -> tuple[Path, ...]:
    """The files that are made beside a store while it is in use."""
    return (*parts(path)[1:], commit_note_path(path))


def names_beside(path: Path) -> tuple[Path, ...]:
    """Every name beside a store's that the service or SQLite gives to a file, but for those set aside, which have a time."""
    made = (being_made_path(path), repaired_path(path))
    of_sqlite = [part for file in (path, *made) for part in (*parts(file)[1:], rollback_path(file))]
    return (*made, *of_sqlite, lock_path(path), commit_note_path(path), ready_path(path))


def kept(path: Path) -> tuple[Path, ...]:
    """The files of a store that cannot be made from others."""
    return (*parts(path)[:2], commit_note_path(path))
