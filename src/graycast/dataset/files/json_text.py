"""Write JSON with sorted keys and one line for each outermost key."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """Return JSON with sorted keys, one line per outermost key, as bop_toolkit writes it.

    Raises:
        ValueError: a value has no JSON form.
    """
    tree = plain(content)
    values = {key: json.dumps(tree[key], sort_keys=True, allow_nan=False) for key in sorted(tree)}
    lines = [f"  {json.dumps(key)}: {value}" for key, value in values.items()]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def plain(value: Any) -> Any:
    """Convert NumPy values, paths, tuples and mappings to JSON's types; NaN becomes null.

    Raises:
        ValueError: a value has another type, or is infinite.
    """
    match value:
        case None | bool() | str() | int():
            return value
        case np.ndarray() | np.generic():
            return plain(value.tolist())
        case float():
            if math.isinf(value):
                raise ValueError("infinity has no JSON form")
            return None if math.isnan(value) else value
        case Path():
            return str(value)
        case Mapping():
            return {str(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
    raise ValueError(f"{value!r} has no JSON form")
