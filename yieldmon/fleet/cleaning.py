"""A dataset's folder before a run writes to it: what is no part of it is refused, and what killed runs left behind is removed."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.fleet.dataset_files import FAILED, MARK, RUN, TEMPORARY, DatasetFiles
from yieldmon.fleet.marks import check_sizes, commit_of


def refuse_foreign(files: DatasetFiles) -> None:
    """Raises InputError for a folder that holds something else."""
    if not files.is_there():
        return
    if not files.is_folder():
        raise InputError(files.address, "is a file", "a folder for the dataset")
    names = files.names()
    own = (FAILED, RUN, TEMPORARY, "")
    foreign = [name for name in names if name not in own and not name.startswith("machine=") and name[:1] != "."]
    if not foreign and not {FAILED, RUN} & {*names}:
        # What another program has partitioned the same way: not to be cleaned.
        marked = any(files.has(f"{name}/{MARK}") for name in files.partitions())
        foreign = [] if marked else [name for name in names if name.startswith("machine=")]
    if foreign:
        raise InputError(files.address, f"holds {foreign[0]}", "an empty folder, or a dataset of `fleet run`")


def refuse_links(files: DatasetFiles) -> None:
    """Raises InputError for a link: cleaning and writing would go through it to what is no part of the dataset."""
    if not files.local or not Path(files.root).is_dir():
        return
    for pattern in ("*", "machine=*/*", f"{FAILED}/*"):
        for part in Path(files.root).glob(pattern):
            if part.is_symlink():
                raise InputError(str(part), "is a link", "a file or folder of the dataset's own; remove the link")


def clean(
    files: DatasetFiles, planned: Collection[str] | None, say: Callable[[InputError], None], require: Callable[[], None]
) -> None:
    """Remove what no mark names.

    Parameters
    ----------
    files : DatasetFiles
    planned, say
        As in `Dataset.begin`.
    require : callable
        Raises where another run has taken the dataset over.
    """
    files.remove(TEMPORARY)
    for name in files.partitions():
        # What a run that began meanwhile is about to write is not whole yet.
        require()
        sizes = files.sizes(name)
        try:
            commit = commit_of(files, name)
            kept = {MARK, *commit.files} if commit is not None else set[str]()
            if commit is not None:
                check_sizes(files, commit, sizes)
        except InputError as error:
            if planned is not None and name not in planned:
                say(error)
                continue
            kept = set()
        for child in {*sizes} - kept:
            files.remove(f"{name}/{child}")
        if not kept:
            files.remove(name)
