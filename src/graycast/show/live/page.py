"""What the page has to know before any picture: reasons, their colours, and colour maps."""

import json
from functools import cache

from ...camera.decode import Reason
from ..report.page.packing import color_table

_COLORMAPS = ("viridis_r", "viridis", "RdBu_r", "gray", "magma")


@cache
def about() -> str:
    """A script that says so."""
    reasons = [
        {
            "number": int(reason),
            "name": reason.name.lower(),
            "color": reason.color,
            "meaning": reason.meaning,
        }
        for reason in Reason
    ]
    content = {
        "reasons": reasons,
        "colormaps": {name: color_table(name) for name in _COLORMAPS},
        "scanners": {},
        "statistics": {"part_error": {"sigma_mm": None}},
    }
    return f"Graycast.report = {json.dumps(content)};\n"
