"""What `python -m benchmarks shelf` measured of each scanner of the shelf."""

from functools import cache
from importlib.resources import files
from pathlib import Path

from ...base.settings import Positive, Settings, check_settings, parse_yaml

MEASURED = "measured.yaml"


class ShelfFigures(Settings):
    """Figures of `graycast rig certify` with a small scope, at the distances `z_m`.

    `noise_m` is the temporal standard deviation of depth, `spacing_m` the distance of neighbouring
    points, `plane_std_m` the standard deviation about the best plane, all of facing planes.
    `length_error` is the error of a ball bar's length, as a share of it.
    """

    z_m: tuple[Positive, ...]
    noise_m: tuple[Positive, ...]
    spacing_m: tuple[Positive, ...]
    plane_std_m: tuple[Positive, ...]
    length_error: float
    capture_s: Positive


class _Table(Settings):
    origin: str
    resolution: str
    scanners: dict[str, ShelfFigures]


@cache
def measured() -> _Table:
    """The stored table: by which command it was made, at which resolution, and the figures."""
    text = files(__package__).joinpath(MEASURED).read_text(encoding="utf-8")
    return check_settings(parse_yaml(text, Path(MEASURED)), _Table, Path(MEASURED))
