"""YAML as data and nothing else: plain mappings, lists, numbers, strings; what is doubtful is refused.

No tags, anchors or aliases, no key twice, a bound on size and depth, and the scalars of YAML 1.2's core schema (1e-3 is
a number; 1:30 and 2020-01-01 are words, and so are yes and off), so that a file can neither run anything, nor mean
something other than what it shows, nor grow in memory.
"""

from __future__ import annotations

import contextlib
import errno
import re
from collections.abc import Callable, Hashable
from math import isfinite
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from yieldmon.bounded import TIMEOUT_S, content
from yieldmon.errors import InputError, reason
from yieldmon.file_kinds import kind_of
from yieldmon.files.yaml_slips import in_plain_words

MAX_BYTES = 100_000
MAX_DEPTH = 20
_PASSING = frozenset({errno.EIO, errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EINTR, errno.ESTALE, errno.ETIMEDOUT})
"""What a file cannot be blamed for: another try may succeed."""
_WHOLE = 2**63
"""Whole numbers are smaller than this: databases and tables have room for no larger ones."""


class _Refused(yaml.MarkedYAMLError):
    def __init__(self, problem: str, place: Any) -> None:
        super().__init__(None, None, problem, place.start_mark)


class _Rules(Composer, SafeConstructor, Resolver):
    """What is refused, whatever reads the characters."""

    peek_event: Callable[[], Any]
    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _Refused("anchors and aliases are not supported", event)
        if getattr(event, "tag", None) is not None:
            raise _Refused(f"tags such as {event.tag!r} are not supported", event)
        if self._depth >= MAX_DEPTH:
            raise _Refused(f"more than {MAX_DEPTH} levels deep", event)
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _Refused("a key must be a word", key)
            if node.flow_style and key.value.isdigit() and isinstance(value, yaml.ScalarNode) and not value.value:
                raise _Refused(f"a comma before {key.value} in a number within {{ }}", key)
            if key.value in seen:
                raise _Refused(f"key {key.value!r} appears twice", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _resolvers() -> dict[str, list[tuple[str, re.Pattern[str]]]]:
    """First character -> the core schema's scalars that can begin with it."""
    core = {
        "null": (r"null|~|", ["n", "~", ""]),
        "bool": (r"true|false", ["t", "f"]),
        "int": (r"[-+]?[0-9]+", list("-+0123456789")),
        "float": (r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan", list("-+.0123456789")),
    }
    table: dict[str, list[tuple[str, re.Pattern[str]]]] = {}
    for name, (pattern, firsts) in core.items():
        for first in firsts:
            table.setdefault(first, []).append((f"tag:yaml.org,2002:{name}", re.compile(rf"(?:{pattern})\Z")))
    return table


_Rules.yaml_implicit_resolvers = _resolvers()


class StrictLoader(_Rules, yaml.SafeLoader):
    """Over PyYAML's own parser."""


def _fast_loader() -> type[yaml.SafeLoader | yaml.CSafeLoader]:
    """Over libyaml, which is several times faster, where PyYAML comes with it."""
    if not yaml.__with_libyaml__:
        return StrictLoader

    class FastLoader(_Rules, yaml.CSafeLoader):
        def __init__(self, stream: str) -> None:
            yaml.CSafeLoader.__init__(self, stream)
            Composer.__init__(self)

    return FastLoader


def _construct_number(_: Any, node: yaml.ScalarNode) -> int | float:
    text = node.value
    try:
        value = int(text) if node.tag.endswith(":int") else float(text.replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError as error:
        raise _Refused(f"{text[:40]!r} has too many digits", node) from error
    if isinstance(value, int) and not -_WHOLE < value < _WHOLE:
        raise _Refused(f"{text[:40]!r} has too many digits", node)
    return value


_FastLoader = _fast_loader()
for _number in ("int", "float"):
    for _loader in (StrictLoader, _FastLoader):
        _loader.add_constructor(f"tag:yaml.org,2002:{_number}", _construct_number)
_PLAIN = re.compile(r"[ -~\n]*")
"""Characters that both readers take alike."""


class _ExactDumper(yaml.SafeDumper):
    """Quotes every text that this reader or YAML 1.1 takes for something else."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _first, _patterns in _resolvers().items():
    for _tag, _pattern in _patterns:
        _ExactDumper.add_implicit_resolver(_tag, _pattern, [_first])


def _represent_float(dumper: _ExactDumper, value: float) -> yaml.ScalarNode:
    if not isfinite(value):
        return dumper.represent_float(value)
    text = repr(value)
    # YAML 1.1 takes 1e-05 for a text; it wants a point in the mantissa.
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _represent_text(dumper: _ExactDumper, value: str) -> yaml.ScalarNode:
    # Line ends that YAML would fold into spaces, unless they are escaped.
    style = '"' if any(end in value for end in "\x85\u2028\u2029") else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)


_ExactDumper.add_representer(float, _represent_float)
_ExactDumper.add_representer(str, _represent_text)


def dump(document: Any) -> str:
    """The YAML text that `parse` reads back as the same document, to the last bit.

    document: mappings, lists, texts, numbers, truth values and None; keys are texts and stay in their order.
    """
    return yaml.dump(document, Dumper=_ExactDumper, sort_keys=False, allow_unicode=True)


def parse(text: str, where: str) -> Any:
    """The document in `text`; None when it is empty.

    Raises InputError, naming `where` and the line, for anything that is not plain YAML.
    """
    if len(text) > MAX_BYTES:
        raise InputError(where, f"{len(text)} characters", f"at most {MAX_BYTES}")
    if _PLAIN.fullmatch(text):
        # What it refuses is read again, for messages that do not depend on libyaml.
        with contextlib.suppress(yaml.YAMLError):
            return yaml.load(text, Loader=_FastLoader)  # noqa: S506 - a SafeLoader with less
    try:
        return yaml.load(text, Loader=StrictLoader)  # noqa: S506 - the same
    except yaml.MarkedYAMLError as error:
        wrong, right, opened = in_plain_words(error.problem or error.context or "not YAML")
        mark = (error.context_mark if opened else None) or error.problem_mark or error.context_mark
        line = f"{where}:{mark.line + 1}" if mark is not None else where
        raise InputError(line, wrong, right) from error
    except yaml.YAMLError as error:
        raise InputError(where, str(error), "a YAML file") from error


def load(path: Path | str) -> Any:
    """The document in the file at `path`. Raises InputError as parse() and read() do."""
    return parse(read(path), str(path))


def read(path: Path | str) -> str:
    """The text of the file at `path`, no more of it than parse() refuses. Raises InputError when it cannot be read."""
    try:
        return content(str(path), MAX_BYTES + 1, TIMEOUT_S).decode("utf-8")
    except OSError as error:
        if error.errno in _PASSING:
            # A read's error does not name its file.
            error.filename = str(path)
            raise
        raise InputError(str(path), reason(error), "a readable YAML file") from error
    except UnicodeDecodeError as error:
        kind = kind_of(error.object)
        problem = f"is {kind}" if kind else f"byte {error.start} is not UTF-8"
        raise InputError(str(path), problem, "a YAML file in UTF-8") from error
