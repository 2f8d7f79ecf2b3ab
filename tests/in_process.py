"""A program of the checkout in the tests' own process, where a test is not about the process: a second of imports less."""

from __future__ import annotations

import contextlib
import importlib
import io
import subprocess
import sys
from unittest import mock


def program(module: str, *words: object) -> subprocess.CompletedProcess[str]:
    """What `python -m module words` does by the module's `main()`, as `subprocess.run` has it: status and texts.

    A package's program is named with its `.__main__`.
    """
    arguments = [module, *map(str, words)]
    out, err = io.StringIO(), io.StringIO()
    with mock.patch.object(sys, "argv", arguments), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = importlib.import_module(module).main()
        except SystemExit as ended:
            status = ended.code
    return subprocess.CompletedProcess(arguments, int(status or 0), out.getvalue(), err.getvalue())
