"""The command line: the list of commands, and how their errors are reported."""

import argparse
import os
import select
import signal
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from typing import Any

from .. import __version__
from ..base.errors import GraycastError, error_line
from . import (
    completing,
    datasets,
    designing,
    detecting,
    evaluating,
    exporting,
    fitting,
    generating,
    labelling,
    living,
    looking,
    machine,
    measuring,
    merging,
    picking,
    rigs,
    starting,
    twinning,
)

COMMAND = "COMMAND"
EXAMPLES = """\
examples:
  graycast demo                                          make a small dataset and its picture
  graycast new bracket --part bracket.stl --unit mm      write a cell for your own part
  graycast generate configs/demo.yaml --out out/demo     make three scenes of brackets in a box
  graycast preview configs/own_part.yaml --out p.png     draw one scene of your own part
  graycast live configs/demo.yaml                        show a cell in the browser
  graycast validate out/demo                             check the files of a dataset
  graycast report out/demo --out out/page                make a web page of a dataset
  graycast train out/demo --out out/detector             train a detector on a dataset
  graycast detect out/detector out/demo --out out/found  find parts in pictures
  graycast merge out/demo --out out/clouds               make one cloud of each scene's views
  graycast export out/demo --format coco --out out/coco  write a dataset in another format
  graycast evaluate run --on out/demo --out out/scores   score detections
  graycast pick configs/cells/ur5e_suction.yaml --out p  let a simulated robot empty bins
  graycast grasps out/demo --tool tool.yaml              label where a gripper can hold parts
  graycast design configs/design/brackets.yaml --out d   compare scanners and their poses
  graycast decode stack.yaml --rig rig.yaml --out cloud  decode a real scanner's pictures
  graycast certify phoxi-l --out sheet                   measure the accuracy of a virtual scanner
  graycast realism real/ --intrinsics K.json --out r     measure the statistics of depth maps
  graycast twin real/ --config cell.yaml --out twin.yaml fit a simulated scanner to real scans
  graycast rig show phoxi-m --out rig.png                draw a rig and its working range
  graycast doctor                                        check what this machine has installed
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return 0 for success, 1 for failure, 2 for wrong arguments."""
    options = _parser().parse_args(arguments)
    if arguments is None:  # a process of its own
        signal.signal(signal.SIGTERM, _stop)  # a batch system's way to say Ctrl-C
    try:
        code = options.run(options) or 0
        sys.stdout.flush()
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


def _nobody_reads() -> bool:
    """Whether the reader of the output is gone, as `head` is after its lines: that is no error."""
    output = select.poll()
    output.register(sys.stdout.fileno(), 0)
    if not any(event & select.POLLERR for _, event in output.poll(0)):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at the end
    return True


def _stop(number: int, frame: object) -> None:
    raise KeyboardInterrupt


class _Parser(argparse.ArgumentParser):
    """A parser whose error names the word that was probably meant, and not thirty others."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError:
            words = [str(choice) for choice in action.choices or ()]
            near = get_close_matches(str(value), words, n=3)
            if not near and action.metavar != COMMAND:
                raise
            help_for = f"{self.prog} --help lists all"
            meant = f"did you mean {' or '.join(near)}?" if near else help_for
            raise argparse.ArgumentError(action, f"{value!r} does not exist: {meant}") from None


@cache  # a process that runs several commands, as the tests do, builds it once
def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="graycast",
        description="Graycast simulates a structured-light camera and makes bin-picking "
        "datasets with it.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"graycast {__version__}")
    parser.set_defaults(run=lambda _: parser.print_help(), debug=False, when_stopped="")
    commands = parser.add_subparsers(metavar=COMMAND)
    starting.add_commands(commands)
    generating.add_commands(commands)
    datasets.add_commands(commands)
    looking.add_commands(commands)
    living.add_commands(commands)
    merging.add_commands(commands)
    exporting.add_commands(commands)
    detecting.add_commands(commands)
    evaluating.add_commands(commands)
    designing.add_commands(commands)
    picking.add_commands(commands)
    labelling.add_commands(commands)
    fitting.add_commands(commands)
    twinning.add_commands(commands)
    rigs.add_commands(commands)
    measuring.add_commands(commands)
    machine.add_commands(commands)
    completing.add_commands(commands, parser)
    return parser
