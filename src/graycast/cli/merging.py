"""The command that makes one cloud of a scene's views: merge."""

import argparse
from pathlib import Path

from .arguments import add_command
from .bars import open_bars

# Heavy modules are imported by the command that needs them, so that --help answers at once.

MERGE = """\
Fuse the views of each scene into one point cloud in the world frame. Where views see the same
surface they are averaged by their noise; a point that other views see through is left out. Each
point keeps its standard deviation, how many views measured it, and why the first view has no depth
there. A table lists what each view measures of the parts' surface, what no other view measures,
and in which order the views add most."""


def add_commands(commands) -> None:
    merge = add_command(commands, "merge", _merge, "Fuse each scene's views into one cloud.")
    merge.description = MERGE
    merge.add_argument(
        "source", type=Path, help="The dataset's folder, or the folder of one of its scenes."
    )
    merge.add_argument(
        "--out", type=Path, required=True, help="The folder to write; it is new or empty."
    )


def _merge(options: argparse.Namespace) -> int:
    from ..score.merge import described, merge

    with open_bars() as bars:
        record = merge(options.source, options.out, progress=bars)
    print(f"{options.out}: clouds of {len(record['scenes'])} scene(s)")
    for surface in record["surfaces"]:
        print("\n".join(described(surface)))
    for doubt in record["doubts"]:
        print(f"warning: {doubt}")
    return 0
