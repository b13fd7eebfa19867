"""Commands about which scanner to take: design."""

import argparse
from pathlib import Path

from ..base.errors import one_line
from .arguments import add_command, add_device, add_workers, workers_of
from .bars import open_bars

# Heavy modules are imported by the command that needs them, so that --help answers at once.

DESIGN = """\
Compare scanners, their poses, codes, exposures and bins on the same heaps of parts. For each
setting of the study the command reports the share of the parts' surface that is measured, the
depth error, the share and the reasons of missing depth, the smallest feature that is resolved,
and the duration of a scan in seconds. It then recommends one setting in a sentence. It writes
tables, a plot of the best settings and a picture of each setting to the folder. If the command
is stopped, the same command continues the study; settings and heaps may be added."""


def add_commands(commands) -> None:
    design = add_command(
        commands, "design", _design, "Compare scanners and their poses, and recommend one."
    )
    design.description = DESIGN
    design.set_defaults(
        when_stopped="the finished scans are kept; run the same command again to continue"
    )
    design.add_argument(
        "study", type=Path, help="The YAML file of the study, such as configs/design/brackets.yaml."
    )
    design.add_argument(
        "--out", type=Path, required=True, help="The folder to which the study is written."
    )
    design.add_argument(
        "--list", action="store_true", help="Only list the settings, without scanning."
    )
    add_device(design)
    add_workers(design, "scans are made")


def _design(options: argparse.Namespace) -> int:
    from ..score.design import read_design, run_design, settings_of, write_design

    workers = workers_of(options)
    spec = read_design(options.study)
    settings = settings_of(spec)
    if options.list:
        print("\n".join(setting.name for setting in settings))
        return 0
    print(f"{len(settings)} settings, {spec.layouts} heaps of parts, seed {spec.seed}")
    with open_bars() as bars:

        def report(name, layout, outcome) -> None:
            shares = ", ".join(f"{share:.1%}" for share in outcome.reasons.values())
            bars.line(f"{name}  heap {layout:03d}  {outcome.seconds:6.1f} s  {shares} measured")

        def failed(name, layout, outcome) -> None:
            bars.line(f"{name}  heap {layout:03d}  failed: {one_line(outcome.error)}")

        lost = run_design(
            spec,
            options.out,
            device=options.device,
            workers=workers,
            on_result=report,
            on_failed=failed,
            progress=bars,
        )
    conclusion = write_design(spec, options.out)
    print((options.out / "table.md").read_text(encoding="utf-8"))
    print(conclusion)
    for name in lost:
        print(f"  {name} is missing; run the same command again to retry it")
    return 1 if lost else 0
