"""Record of the statistics of a set of depth maps, stored as JSON; None means unknown."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from ...base.errors import DatasetError, GraycastError

RECORD_FILE = "realism.json"  # in the folder that `graycast real measure` writes
FORMAT_VERSION = 4


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class BinRecord(_Record):
    """A statistic of the samples in one bin of a quantity, such as brightness (0 to 1)."""

    low: float
    high: float
    count: int
    value: float | None  # None if `count` is 0
    interval: tuple[float, float] | None = None  # 95 % confidence interval of the value


class DropOut(_Record):
    """The brightness below which most dark pixels have no depth.

    From `missing_below` to `missing_above`, the missing share falls by a quarter at `first`, by
    half at `brightness` and by three quarters at `last`.
    """

    brightness: float
    first: float
    last: float
    missing_below: float
    missing_above: float


class Missing(_Record):
    """Missing pixels as shares of all pixels."""

    share: float
    by_brightness: list[BinRecord]
    by_reason: dict[str, float]
    drop_out: DropOut | None


class Noise(_Record):
    """Standard deviation of z [m] about planes fitted to small patches.

    `percentiles_m` has the 5th, 25th, 50th, 75th and 95th percentile over patches. `candidates`
    counts the patches with few holes, `bent` is the share of these that are not planes, and
    `outliers` is the share of pixels beyond 5 standard deviations.
    """

    patch_px: int
    candidates: int
    patches: int
    bent: float | None
    outliers: float | None
    percentiles_m: list[float] | None
    relative: float | None  # median ratio of noise to depth


class Fine(_Record):
    """Noise [m] from second differences in small tiles, without noise that neighbours share.

    White noise keeps its standard deviation; smoothed noise has a lower value. `percentiles_m` has
    the same percentiles as `Noise`, over tiles. `rough` is the share of tiles without a smooth
    surface. `dark_to_bright` is the ratio of the noise in the darkest bin to the brightest bin, and
    `steep_to_facing` the ratio of the noise at 40 to 50 degrees of incidence to 0 to 10 degrees.
    """

    tile_px: int
    tiles: int
    rough: float | None
    percentiles_m: list[float] | None
    by_brightness: list[BinRecord]  # median noise [m] at angles of incidence below 45 degrees
    by_incidence: list[BinRecord]  # bin limits in degrees
    dark_to_bright: float | None
    steep_to_facing: float | None


class Pairs(_Record):
    """Noise [m] of one map, from pairs of successive maps that show the same surface.

    The autocorrelation is at lags of 1, 2 and 3 pixels; None if no two maps share enough pixels.
    """

    pairs: int
    pixels: int
    sigma_m: float | None
    along_rows: list[float] | None
    along_columns: list[float] | None


class Autocorrelation(_Record):
    """Autocorrelation of the noise at lags of 1, 2 and 3 pixels, along rows and columns."""

    patches: int
    along_rows: list[float] | None
    along_columns: list[float] | None


class Jumps(_Record):
    """Mean numbers per map of jumps: neighbours with depth on different surfaces."""

    right_farther: float  # jumps at which the right pixel is farther
    left_farther: float
    below_farther: float
    above_farther: float


class Baseline(_Record):
    """The projector's position in the camera frame, from the widths of shadows.

    `side` is the side of the projector in the image. `plain_m` is the most frequent value of
    w / (f (1/z_near - 1/z_far)) for gaps of width w, which assumes a projector at the camera's z.
    The fit gives the components `across_m` (towards `side`) and `forward_m` (along z), the length
    `baseline_m` with its standard deviation `error_m` (dark or ragged edges may add 5 to 15 % to
    the length), and `eaten_px`, the excess width of a gap over its shadow. `gaps.py` describes the
    assumptions.
    """

    side: str
    gaps: int
    edges: float  # number of edges that cast the shadows
    agreeing: float  # share of edges that agree with the fit within 20 %
    plain_m: float
    baseline_m: float
    error_m: float
    across_m: float
    forward_m: float
    eaten_px: float
    known_m: float | None


class Steps(_Record):
    """Mean number of pixels at depth steps per map, and the share of flying pixels among them."""

    pixels: float
    flying: float | None


class Islands(_Record):
    """Connected groups of at most `largest_px` pixels: number per map, and share of all pixels.

    Holes have no depth, specks have depth. The keys of `..._by_size` are sizes of groups in pixels.
    """

    largest_px: int
    holes: float
    specks: float
    holes_by_size: dict[str, float]
    specks_by_size: dict[str, float]
    hole_share: float
    speck_share: float


class Realism(_Record):
    """All statistics of a set of depth maps."""

    format_version: int = FORMAT_VERSION
    name: str
    scans: int
    pixels: int
    median_depth_m: float | None
    missing: Missing
    noise: Noise
    fine: Fine
    pairs: Pairs
    autocorrelation: Autocorrelation
    jumps: Jumps
    steps: Steps
    baseline: Baseline | None
    islands: Islands


def write_record(record: Realism, path: Path) -> None:
    """Write a record as JSON.

    Raises:
        GraycastError: the file cannot be written.
    """
    try:
        path.write_text(record.model_dump_json(indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise GraycastError(f"{path}: cannot be written: {error.strerror}") from error


def read_record(path: Path) -> Realism:
    """Read a record from its file, or from a folder that `graycast real measure` wrote.

    Raises:
        DatasetError: the file is missing, or has a wrong form or version.
    """
    file = path / RECORD_FILE if path.is_dir() else path
    try:
        record = Realism.model_validate_json(file.read_bytes())
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(key) for key in first["loc"]) or "the file"
        remedy = "measure the depth maps again with graycast real measure"
        raise DatasetError(f"{file}: {where}: {first['msg']}: {remedy}") from error
    if record.format_version != FORMAT_VERSION:
        raise DatasetError(
            f"{file}: has format_version {record.format_version}, and this version of Graycast "
            f"reads {FORMAT_VERSION}: measure the depth maps again"
        )
    return record
