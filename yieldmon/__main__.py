"""``python -m yieldmon``."""

from __future__ import annotations

import sys

from yieldmon.cli.main import main

sys.exit(main())
