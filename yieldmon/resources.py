"""Where the files shipped with the package are: beside the code in a wheel, at the top of the tree in a checkout."""

from __future__ import annotations

from pathlib import Path

from yieldmon.errors import InputError

_PACKAGE = Path(__file__).resolve().parent


def shipped(name: str) -> Path:
    """Path of a shipped file or folder.

    Parameters
    ----------
    name : str
        Such as ``dbc/yieldmon.dbc`` or ``config/machines/sprocket-8.yaml``.

    Returns
    -------
    Path

    Raises
    ------
    FileNotFoundError
        When the installation lacks it.

    Examples
    --------
    >>> api.shipped("dbc/yieldmon.dbc").name
    'yieldmon.dbc'
    """
    for root in (_PACKAGE / "data", _PACKAGE.parent):
        path = root / name
        if path.exists():
            return path
    raise FileNotFoundError(f"{name}: not part of this installation of yieldmon")


def file_or_shipped(name: str, folder: str, option: str) -> Path:
    """The file that a user names by its path, or a shipped one by its name.

    Parameters
    ----------
    name : str
        A path, or the name of a shipped file without its ending.
    folder : str
        Of the shipped files, such as ``config/machines``.
    option : str
        That the name was given to, for the error.

    Returns
    -------
    Path
        ``name`` itself where there is such a file or it has an ending.

    Raises
    ------
    InputError
        Where it is neither, with the shipped names.
    """
    path = Path(name)
    if path.exists() or path.suffix:
        return path
    known = sorted(file.stem for file in shipped(folder).glob("*.yaml"))
    if name not in known:
        raise InputError(option, f"{name!r} is neither a file nor shipped", f"a path, or one of {', '.join(known)}")
    return shipped(f"{folder}/{name}.yaml")
