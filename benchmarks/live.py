"""Response times of `graycast live` to a change of a setting, for docs/measurements/live.md."""

import math
import time
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from graycast.base.errors import GraycastError
from graycast.cell.config import load_config
from graycast.show.live import Message, Session

from .figures import Figures, Show

RESOLUTION = "small"  # 516 x 386 pixels, for which the page states target times
WAIT_S = 300.0


def measure(*, config: Path, rounds: int, show: Show) -> Figures:
    """Return the waits [ms] for the first and the finished picture after a change of a setting.

    Each round changes a threshold, the exposure, the ambient light, the tilt of the rig and the
    seed. The next change is made when the picture of the previous change is finished.

    Args:
        config: a configuration with the rig of a preset, which is shown at 516 x 386 pixels.

    Raises:
        GraycastError: the cell cannot be shown, or the process that shows it has ended.
    """
    heard: SimpleQueue[Message] = SimpleQueue()
    seed = load_config(config).seed
    session = Session(config, device="auto", on_message=heard.put)
    try:
        session.set("resolution", RESOLUTION)
        session.open()
        _finished(session, heard)
        waited: dict[str, list[float]] = {}
        for number in range(rounds):
            share = number % 5 / 5
            for name, key, value in (
                ("threshold", "decode.min_contrast", 0.02 + 0.05 * share),
                ("exposure", "exposure.target", 0.4 + 0.3 * share),
                ("ambient", "ambient", 1.1 + share),
                ("tilt", "view.tilt_deg", 1.0 + number),
                ("seed", "seed", seed + 1 + number),
            ):
                session.set(key, value)
                first_ms, whole_ms = _finished(session, heard)
                waited.setdefault(f"{name}_first_ms", []).append(first_ms)
                waited.setdefault(f"{name}_finished_ms", []).append(whole_ms)
            show(f"round {number + 1} of {rounds}")
    finally:
        session.close()
    rows = [
        {
            "wait": name,
            "median": float(np.median(ms)),
            "p95": float(np.percentile(ms, 95)),
            "least": float(min(ms)),
        }
        for name, ms in waited.items()
    ]
    return {"rounds": rounds, "resolution": RESOLUTION, "waits": rows}


def _finished(session: Session, heard: "SimpleQueue[Message]") -> tuple[float, float]:
    """Return the waits [ms] for the first and the finished picture of the last request."""
    wanted, first_ms = session.number, math.nan
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        message = heard.get(timeout=WAIT_S)
        if message.kind == "error":
            raise GraycastError(str(message.content["error"]))
        if message.kind != "picture" or message.content["number"] != wanted:
            continue
        if message.content["first"]:
            first_ms = message.content["waited_ms"]
        if message.content["exact"]:
            return first_ms, message.content["waited_ms"]
    raise GraycastError(f"no finished picture within {WAIT_S:g} s: the machine may be too busy")
