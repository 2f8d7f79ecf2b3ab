"""YAML that is plain data, and everything else refused in one line."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.errors import InputError
from yieldmon.files import strict_yaml
from yieldmon.resources import shipped

SCALARS = [
    ("1", 1), ("-7", -7), ("010", 10), ("1e-3", 1e-3), ("2.5E+2", 250.0), (".5", 0.5), ("3.", 3.0), ("true", True),
    ("false", False), ("null", None), ("~", None), ("", None), ("yes", "yes"), ("off", "off"), ("1:30", "1:30"),
    ("2020-13-45", "2020-13-45"), ("0x10", "0x10"), ("1_000", "1_000"), ("'1'", "1"), ("<<", "<<"), ("=", "="),
]  # fmt: skip


@pytest.mark.parametrize(("text", "value"), SCALARS)
def test_scalars_are_those_of_the_core_schema(text, value):
    result = strict_yaml.parse(f"key: {text}\n", "f")["key"]
    assert result == value
    assert type(result) is type(value)


def test_infinities_and_nan_are_numbers_for_the_reader_to_refuse():
    values = strict_yaml.parse("[.inf, -.inf, .nan]", "f")
    assert values[:2] == [math.inf, -math.inf]
    assert math.isnan(values[2])


REFUSED = [
    ("a: 1\na: 2", "f:2: key 'a' appears twice"),
    ("a: &x 1\nb: *x", "f:1: anchors and aliases"),
    ("a:\n  !!python/object/apply:os.system ['true']", "f:2: tags such as"),
    ("[" * 500 + "]" * 500, "f:1: more than 20 levels deep"),
    ("{[1]: 2}", "f:1: a key must be a word"),
    ("a: '", "f:1: a quote that is not closed; expected the same quote at the end of the text"),
    ("a: " + "9" * 5000, "f:1: '9999999999999999999999999999999999999999' has too many digits"),
    ("a: 1\n---\nb: 2", "f:2: --- within the file; expected one document"),
    ("a: \x00", "f: unacceptable character"),
    ("a: " + "x" * strict_yaml.MAX_BYTES, "characters; expected at most"),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_what_is_doubtful_is_refused_with_its_line(text, message):
    with pytest.raises(InputError) as caught:
        strict_yaml.parse(text, "f")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(1 - 2**63, 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8")),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abcdef_", min_size=1), inner, max_size=4),
    max_leaves=20,
)


@settings(max_examples=200)
@given(PLAIN)
def test_plain_data_survives_writing_and_reading(document):
    assert strict_yaml.parse(strict_yaml.dump(document), "f") == document


@pytest.mark.parametrize(
    "text",
    ["0E0", "1e5", "-.5", "3.", "010", "0x10", "1:30", "null", "~", "", "true", "yes", "2020-01-01", ".nan", " a", "a: b", "#"],
)
def test_a_text_that_looks_like_something_else_stays_a_text(text):
    assert strict_yaml.parse(strict_yaml.dump({"key": text}), "f") == {"key": text}
    assert yaml.safe_load(strict_yaml.dump({"key": text})) == {"key": text}


@settings(max_examples=300)
@given(st.text(st.sampled_from("ab:-[]{}&*!|>'\"#%@`,? \n\t01.e~<=\\")))
def test_any_text_is_data_or_one_line(text):
    with suppress(InputError):
        strict_yaml.parse(text, "f")


def test_unreadable_files_are_one_line(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        strict_yaml.load(tmp_path / "missing.yaml")
    with pytest.raises(InputError, match="directory"):
        strict_yaml.load(tmp_path)
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"name: K\xf6ln\n")
    with pytest.raises(InputError, match="byte 7 is not UTF-8"):
        strict_yaml.load(latin)


FORMS = """\
block: {flow: [1, -2.5, .inf, {deep: "a\\tb"}], empty: , word: 'it''s'}
folded: >-
  one
  two

  three
literal: |
  as
   it is
list:
- 1
-  - [a, b]
   - c: null
? key
: value
"""


@pytest.mark.parametrize("text", [FORMS, *(path.read_text() for path in sorted(shipped("config").rglob("*.yaml")))])
def test_plain_characters_are_read_as_among_others(text):
    """ASCII goes through libyaml where it is there, anything else through PyYAML's own parser."""
    assert repr(strict_yaml.parse(text, "x")) == repr(strict_yaml.parse(text + "# \u00e9\n", "x"))


def test_a_read_that_fails_this_time_names_its_file():
    """Linux refuses to read the first byte of a process's memory, as a disk that fails does."""
    with pytest.raises(OSError, match="Input/output error") as caught:
        strict_yaml.read("/proc/self/mem")
    assert caught.value.filename == "/proc/self/mem"


def _silent_pipe(place: Path) -> list[int]:
    """Somebody has it open and writes nothing."""
    os.mkfifo(place)
    return [os.open(place, os.O_RDWR)]


def _terminal(place: Path) -> list[int]:
    ends = os.openpty()
    place.symlink_to(os.ttyname(ends[1]))
    return list(ends)


@pytest.mark.parametrize("make", [_silent_pipe, _terminal])
def test_what_gives_nothing_and_does_not_end_is_refused(
    tmp_path: Path, make: Callable[[Path], list[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reload would wait for it, and the measuring with it."""
    monkeypatch.setattr(strict_yaml, "TIMEOUT_S", 0.2)
    ends = make(tmp_path / "c.yaml")
    with pytest.raises(InputError, match=r"c\.yaml: does not end within 0 s; expected a file"):
        strict_yaml.load(tmp_path / "c.yaml")
    for end in ends:
        os.close(end)


def test_a_pipe_that_is_written_in_pieces_is_read_whole(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "c.yaml")
    writing = os.open(tmp_path / "c.yaml", os.O_RDWR)

    def write() -> None:
        for piece in (b"a: 1\n", b"b: [2,", b" 3]\n"):
            os.write(writing, piece)
            time.sleep(0.05)
        os.close(writing)

    writer = threading.Thread(target=write)
    writer.start()
    assert strict_yaml.load(tmp_path / "c.yaml") == {"a": 1, "b": [2, 3]}
    writer.join()
