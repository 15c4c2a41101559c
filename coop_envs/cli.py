"""The ``coop`` launcher: finds commands by entry points and imports only the one that is called.

A command is an entry point of the group ``coop_envs.commands``, a function ``main(argv) -> exit code``. Exit codes: 0
success, 1 the command's own failure, 2 a user's mistake told in one line, 130 interrupted.
"""

from __future__ import annotations

import ast
import contextlib
import difflib
import importlib.util
import io
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path
from typing import TypeVar

from coop_envs.errors import ConfigError, CoopError

GROUP = "coop_envs.commands"
Options = TypeVar("Options")


class UsageError(CoopError):
    """A command line that cannot be read."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``coop COMMAND ...``."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    commands = {point.name: point for point in entry_points(group=GROUP)}
    if not arguments or arguments[0] in ("-h", "--help"):
        sys.stdout.write(_help(commands))
        return 0 if arguments else 2
    if arguments[0] == "--version":
        sys.stdout.write(f"coop_envs {version('coop_envs')}\n")
        return 0
    return guarded(lambda: _command(commands, arguments[0])(arguments[1:]))


def guarded(run: Callable[[], int]) -> int:
    """Exit code of ``run()``, with users' mistakes and Ctrl-C told in one line on stderr."""
    try:
        return run()
    except CoopError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except ModuleNotFoundError as error:
        sys.stderr.write(f"error: module {error.name!r} is not installed; `coop doctor` says what brings it\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return 130


def parse(options: type[Options], command: str, argv: Sequence[str]) -> Options:
    """Read a command's options, a dataclass, from its arguments; ``--help`` prints them and exits.

    Raises:
        UsageError: what tyro says about an unknown, missing or malformed option, in one line.
    """
    import tyro

    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(options, prog=f"coop {command}", args=list(argv))
    except SystemExit as stop:
        if not stop.code:
            raise
    raise UsageError(_unboxed(complaint.getvalue())) from None


def _command(commands: dict[str, EntryPoint], name: str) -> Callable[[list[str]], int]:
    if name not in commands:
        close = difflib.get_close_matches(name, commands, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise ConfigError("command", name, f"one of {', '.join(sorted(commands))}{hint}")
    return commands[name].load()


def _help(commands: dict[str, EntryPoint]) -> str:
    width = max(map(len, commands), default=0)
    rows = [f"  {name:<{width}}  {_summary(commands[name].module)}" for name in sorted(commands)]
    lines = ["usage: coop COMMAND [OPTIONS]", "", *rows, "", "`coop COMMAND --help` lists a command's options."]
    return "\n".join(lines) + "\n"


def _summary(module: str) -> str:
    """First line of a module's docstring, read without importing the module."""
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        return "(not installed)"
    documentation = ast.get_docstring(ast.parse(Path(spec.origin).read_text(encoding="utf-8"))) or ""
    return documentation.partition("\n")[0]


def _unboxed(text: str) -> str:
    """The words of tyro's boxed message, in one line."""
    rows = [row.strip(" │╭╮╰╯─") for row in text.splitlines()]
    title, *body = [row for row in rows if row]
    return f"{title}: {' '.join(row for row in body if 'full helptext' not in row)}"
