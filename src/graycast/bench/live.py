"""Response times of a live cell for the three kinds of change, without the browser."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from ..config import load_config
from ..errors import GraycastError
from ..live import Message, Session
from .figures import Figures

RESOLUTION = "small"  # 516 x 386, of which the aims speak
WAIT_S = 300.0


def measure_live(
    path: Path, *, rounds: int, device: str, on_round: Callable[[int], None]
) -> Figures:
    """Median and 95th percentile of the wait for the first picture of a change [ms].

    Each round changes a threshold, the exposure, the ambient light, the tilt of the rig and the
    seed; the next change waits until the picture of the last one is finished.

    Args:
        path: of a configuration with a preset's rig, which is shown at 516 x 386.
        on_round: called with the rounds that are done.

    Raises:
        GraycastError: the cell cannot be shown; or the process that shows it has ended.
    """
    heard: SimpleQueue[Message] = SimpleQueue()
    config = load_config(path)
    session = Session(path, device=device, on_message=heard.put)
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
                ("seed", "seed", config.seed + 1 + number),
            ):
                session.set(key, value)
                first_ms, whole_ms = _finished(session, heard)
                waited.setdefault(f"{name}_first_ms", []).append(first_ms)
                waited.setdefault(f"{name}_finished_ms", []).append(whole_ms)
            on_round(number + 1)
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
    """Wait for the finished picture of what was asked last; when its first and its last came."""
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
