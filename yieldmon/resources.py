"""Where the files shipped with the package are: beside the code in a wheel, at the top of the tree in a checkout."""

from __future__ import annotations

from pathlib import Path

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
