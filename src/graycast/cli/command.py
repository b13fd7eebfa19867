"""The command line: which commands there are, and how their errors are told."""

import argparse
import signal
import sys
from collections.abc import Sequence

from .. import __version__
from ..errors import GraycastError, told
from . import (
    benching,
    datasets,
    designing,
    detecting,
    exporting,
    fitting,
    generating,
    judging,
    labelling,
    living,
    looking,
    machine,
    measuring,
    merging,
    picking,
    rigs,
    twinning,
)

EXAMPLES = """\
examples:
  graycast generate configs/demo.yaml --out out/demo     three scenes of brackets in a box
  graycast preview configs/own_part.yaml --out p.png     one scene of your own part as a picture
  graycast live configs/demo.yaml                        a cell in the browser, to turn at
  graycast validate out/demo                             check a dataset from its files
  graycast report out/demo --out out/page                a web page to look at it
  graycast train out/demo --out out/detector             a detector of the dataset's parts
  graycast detect out/detector out/demo --out out/found  what it finds in pictures
  graycast merge out/demo --out out/clouds               one cloud of each scene's views
  graycast export out/demo --format coco --out out/coco  the same for a trainer, in its format
  graycast evaluate run --on out/demo --out out/scores   how good detections are
  graycast pick configs/cells/ur5e_suction.yaml --out p  a simulated robot that empties bins
  graycast grasps out/demo --tool tool.yaml              label where a gripper holds the parts
  graycast design configs/design/brackets.yaml --out d   which scanner to take, and where
  graycast decode stack.yaml --rig rig.yaml --out cloud  depth from a real scanner's pictures
  graycast certify phoxi-l --out sheet                   what a virtual scanner is worth
  graycast realism real/ --intrinsics K.json --out r     how real depth maps look, in figures
  graycast twin real/ --config cell.yaml --out twin.yaml a scanner whose scans look like real ones
  graycast rig show phoxi-m --out rig.png                what a rig sees, as a picture
  graycast doctor                                        what this machine has and lacks
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 failed, 2 wrong arguments."""
    options = _parser().parse_args(arguments)
    if arguments is None:  # a process of its own
        signal.signal(signal.SIGTERM, _stop)  # a batch system's way to say Ctrl-C
    try:
        return options.run(options) or 0
    except KeyboardInterrupt:
        print(f"graycast: stopped; {options.when_stopped}", file=sys.stderr)
        return 130
    except (GraycastError, ValueError, OSError, MemoryError) as error:
        if options.debug:
            raise
        print(f"graycast: error: {told(error)}", file=sys.stderr)
        return 1


def _stop(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="graycast",
        description="Simulates a structured-light camera and makes bin-picking datasets with it.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"graycast {__version__}")
    parser.set_defaults(run=lambda _: parser.print_help(), debug=False, when_stopped="")
    commands = parser.add_subparsers(metavar="COMMAND")
    generating.add_commands(commands)
    datasets.add_commands(commands)
    looking.add_commands(commands)
    living.add_commands(commands)
    merging.add_commands(commands)
    exporting.add_commands(commands)
    detecting.add_commands(commands)
    judging.add_commands(commands)
    designing.add_commands(commands)
    picking.add_commands(commands)
    labelling.add_commands(commands)
    fitting.add_commands(commands)
    twinning.add_commands(commands)
    rigs.add_commands(commands)
    measuring.add_commands(commands)
    machine.add_commands(commands)
    benching.add_commands(commands)
    return parser
