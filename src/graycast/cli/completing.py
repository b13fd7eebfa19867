"""The command that teaches a shell this program's words: completion."""

import argparse
from functools import partial
from pathlib import Path

from .arguments import add_command

COMPLETION = """\
Print a script with which a shell completes commands, options, choices and names of files. For bash,
write it to ~/.local/share/bash-completion/completions/graycast; for zsh, to a file _graycast in a
folder that $fpath names. A new shell reads it."""


def add_commands(commands, parser: argparse.ArgumentParser) -> None:
    """`parser` is that of the whole program."""
    completion = add_command(
        commands,
        "completion",
        partial(_completion, parser),
        "Print a script with which a shell completes this program's commands and options.",
    )
    completion.description = COMPLETION
    completion.add_argument(
        "shell", choices=("bash", "zsh"), help="The shell that the script is for."
    )


def _completion(parser: argparse.ArgumentParser, options: argparse.Namespace) -> int:
    import shtab

    _complete_files(parser)
    print(shtab.complete(parser, shell=options.shell))
    return 0


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Tell shtab which arguments are files."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _complete_files(inner)
        elif action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
