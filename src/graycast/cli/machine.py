"""Commands about this machine and this program: doctor, schema, bench."""

import argparse
import json
from pathlib import Path
from typing import Any

from .arguments import add_command, add_device, positive


def add_commands(commands) -> None:
    add_command(
        commands,
        "doctor",
        _doctor,
        "Print what this machine has, lacks, and what that would give.",
    )
    schema = add_command(
        commands, "schema", _schema, "Print the JSON Schema of a file, for editors."
    )
    schema.add_argument("kind", choices=("config", "rig", "stack"), help="which file")

    bench = add_command(commands, "bench", _bench, "Measure speed and memory on this machine.")
    bench.add_argument(
        "what", choices=("render", "decode", "drop", "scene"), help="which stage, or all of a scene"
    )
    bench.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    bench.add_argument("--count", type=positive, default=30, help="parts per scene (default 30)")
    bench.add_argument("--scenes", type=positive, default=3, help="for scene (default 3)")
    add_device(bench)


def _doctor(options: argparse.Namespace) -> int:
    from ..doctor import describe, examine

    print(describe(examine()))
    return 0


def _schema(options: argparse.Namespace) -> int:
    from ..config import config_schema
    from ..rig_file import rig_schema
    from ..stack import stack_schema

    schemas = {"config": config_schema, "rig": rig_schema, "stack": stack_schema}
    print(json.dumps(schemas[options.kind](), indent=2))
    return 0


def _bench(options: argparse.Namespace) -> int:
    from .. import bench

    figures: dict[str, Any] = bench.run(
        options.what, device=options.device, count=options.count, scenes=options.scenes
    )
    print(bench.describe(figures))
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
        print(options.json)
    return 0
