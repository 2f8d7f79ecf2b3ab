"""What reading a damaged zip raises."""

from __future__ import annotations

import struct
import zipfile
import zlib

ZIP_DAMAGE = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,  # a compression that is not known
    RuntimeError,  # a member that is encrypted
    UnicodeError,  # names that are not what their flag says
    struct.error,
    OverflowError,
)
