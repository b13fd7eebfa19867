"""The command line: the groups of commands, their help, and reports of their errors."""

import argparse
import os
import select
import signal
import sys
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from functools import cache, partial
from pathlib import Path
from typing import Any

from ..base.errors import GraycastError, error_line
from ..base.version import __version__
from ..learn.detect.networks import RF_DETR
from . import (
    dataset_commands,
    detector_commands,
    real_commands,
    rig_commands,
    robot_commands,
    scene_commands,
    start_commands,
)

GONE = {  # former names, each with a text about its replacement
    "rf-detr": RF_DETR,
    "film": "film is gone: graycast robot report writes a page that replays picks; record its "
    "window with the browser or with ffmpeg",
}

COMPLETION = """\
Print a script with which a shell completes commands, options and names of files. For
bash, write it to ~/.local/share/bash-completion/completions/graycast; for zsh, to a file _graycast
in a folder that $fpath names. A new shell reads it."""


EXAMPLES = """\
examples:
  graycast demo                                      make a small dataset and its picture
  graycast new bracket --part bracket.stl --unit mm  write a cell for your own part
  graycast preview bracket/cell.yaml --out p.png     draw one scene of it
  graycast generate bracket/cell.yaml --out data     make its dataset
  graycast report data --out page                    make a web page of the dataset
  graycast rig decode stack --rig rig.yaml --out d   decode the pictures of a real scanner
  graycast detector train data --out detector        train a detector on it
  graycast robot --help                              list the commands of a group
"""


class Help(argparse.HelpFormatter):
    """A help formatter that shows only required arguments in the usage line and keeps indents."""

    def _format_usage(
        self,
        usage: str | None,
        actions: Iterable[argparse.Action],
        groups: Iterable[argparse._MutuallyExclusiveGroup],
        prefix: str | None,
    ) -> str:
        needed = [group for group in groups if group.required]
        either = [action for group in needed for action in group._group_actions]
        every = list(actions)
        words = [action for action in every if not action.option_strings]
        options = [a for a in every if a.option_strings and (a.required or a in either)]
        text = super()._format_usage(usage, words, [], prefix).rstrip()
        if options:
            more = super()._format_usage(None, options, needed, "").strip()
            text += more.removeprefix(self._prog)
        return text + (" [options]" if len(words) + len(options) < len(every) else "") + "\n\n"

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        fill = super()._fill_text
        return "\n".join(
            line if line.startswith("  ") or not line else fill(line, width, indent)
            for line in text.split("\n")
        )


class Parser(argparse.ArgumentParser):
    """A parser whose error for an unknown word suggests similar words instead of listing all."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**({"formatter_class": Help} | settings))

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if value in GONE:
            raise argparse.ArgumentError(action, GONE[value])
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError:
            words = [str(choice) for choice in action.choices or ()]
            near = get_close_matches(str(value), words, n=3)
            if isinstance(action, argparse._SubParsersAction):
                inside = _in_groups(action)
                if value in inside or not near:
                    near = [inside[name] for name in get_close_matches(value, inside, n=1)]
            elif not near:
                raise
            help_for = f"{self.prog} --help lists all"
            meant = f"did you mean {' or '.join(near)}?" if near else help_for
            raise argparse.ArgumentError(action, f"{value!r} does not exist: {meant}") from None


def _in_groups(commands: argparse._SubParsersAction) -> dict[str, str]:
    """Return the full name of each command in a group, such as `dataset export` for `export`."""
    return {
        name: f"{group} {name}"
        for group, parser in commands.choices.items()
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for name in action.choices
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 (success), 1 (failure) or 130 (Ctrl-C); exit with 2 if misused."""
    options = _parser().parse_args(arguments)
    if arguments is None:  # The command runs in its own process.
        signal.signal(signal.SIGTERM, _stop)  # Batch systems send this in place of Ctrl-C.
        # A command that has done its work must not fail because the terminal cannot show a name.
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        code = options.run(options) or 0
        sys.stdout.flush()
        _note_lack_of_cache()
        return code
    except KeyboardInterrupt:
        print(f"graycast: the command was stopped; {options.when_stopped}", file=sys.stderr)
        return 130
    except (GraycastError, ValueError, OSError, MemoryError) as error:
        if isinstance(error, BrokenPipeError) and _nobody_reads():
            return 1
        if options.debug:
            raise
        print(f"graycast: error: {error_line(error)}", file=sys.stderr)
        return 1


def _note_lack_of_cache() -> None:
    """Print a note if compiled code cannot be kept for the next command."""
    kernels = sys.modules.get("graycast.base.kernels")  # An import here would be slow.
    problem = None if kernels is None else kernels.uncached_note()
    if problem is not None:
        print(
            f"graycast: note: {problem}, so compiled code is not kept, and the next command takes "
            "as long: set XDG_CACHE_HOME, or NUMBA_CACHE_DIR if you use it, to a folder that can "
            "be written",
            file=sys.stderr,
        )


def _nobody_reads() -> bool:
    """Return whether the reader of the output, such as `head`, has ended, which is no error."""
    output = select.poll()
    output.register(sys.stdout.fileno(), 0)
    if not any(event & select.POLLERR for _, event in output.poll(0)):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # The flush at exit needs it.
    return True


def _stop(number: int, frame: object) -> None:
    raise KeyboardInterrupt


@cache  # built once in a process that runs several commands, as the tests do
def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="graycast",
        description="Graycast simulates a structured-light camera, decodes its pictures and "
        "those of real scanners, and makes bin-picking datasets with it.",
        epilog=f"{EXAMPLES}\n{_documentation()}",
    )
    parser.add_argument("--version", action="version", version=f"graycast {__version__}")
    parser.add_argument("--print-completion", choices=("bash", "zsh"), help=COMPLETION)
    parser.set_defaults(run=partial(_alone, parser), debug=False, when_stopped="")
    commands = parser.add_subparsers(metavar="COMMAND")
    parser._positionals.title = "commands: the scanner, its datasets, then detectors and robots"
    start_commands.add_first(commands)
    scene_commands.add_commands(commands)
    rig_commands.add_commands(commands)
    real_commands.add_commands(commands)
    dataset_commands.add_commands(commands)
    detector_commands.add_commands(commands)
    robot_commands.add_commands(commands)
    start_commands.add_last(commands)
    return parser


def _documentation() -> str:
    """Return the place of the documentation: in the clone of this program, or its repository."""
    pages = Path(__file__).parents[3] / "docs" / "index.md"
    if pages.is_file():
        return f"documentation:\n  {pages}; `make docs` makes a site of it"
    return "documentation:\n  docs/index.md of Graycast's repository, which a wheel lacks"


def _alone(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Print the help, or the script for `--print-completion`, if no command is given."""
    if options.print_completion is None:
        parser.print_help()
        return
    import shtab

    _complete_files(parser)
    print(shtab.complete(parser, shell=options.print_completion))


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Mark the arguments that are files, so that shtab completes file names."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _complete_files(inner)
        elif action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
