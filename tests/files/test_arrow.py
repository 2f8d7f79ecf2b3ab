"""pyarrow's look for pandas, which takes longer than the table that is written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys
from yieldmon.fleet import tables
from yieldmon.service.logs.tables import open_table
from yieldmon.files.arrow import without_pandas
before = sys.argv[1:] == ["before"]
if before:
    import pandas
tables.write(tables.FAULTS, [{"code": "a", "begin_s": 1.0}], __import__("pathlib").Path("faults.parquet"))
with open_table("records.parquet"):
    pass
assert before == ("pandas" in sys.modules)
without_pandas()
import pandas
import pyarrow.parquet
print(pyarrow.parquet.read_table("faults.parquet").to_pylist()[0]["code"], pandas.Series([1]).sum())
"""


@pytest.mark.parametrize("words", [(), ("before",)])
def test_tables_are_written_without_pandas(tmp_path: Path, words: tuple[str, ...]) -> None:
    """Which may be imported before and afterwards."""
    pytest.importorskip("pandas")
    said = subprocess.run((sys.executable, "-c", SCRIPT, *words), cwd=tmp_path, capture_output=True, text=True, check=True)
    assert said.stdout == "a 1\n"
