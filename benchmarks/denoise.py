"""Effect of denoisers on decoded depth, for docs/measurements/renderers.md.

Frames of Cycles have independent noise, as in K. Bai et al. 2024; frames of Mitsuba's one pass have
common noise. Each renderer is compared with its own converged pictures, so that differences between
the renderers have no effect. The sensor has no noise except in the table that states it. Rig
and code are the paper's: white light, and Gray code along the baseline. The last table is for a
rig with light of one band, where the denoisers of Cycles get pictures of pure red.
"""

from graycast.camera.sensor import SensorSpec
from graycast.cell.resolve import Cell
from graycast.rendering import DenoiserName, Renderer
from graycast.world.scene import Layout

from .cells import GRAY, bracket_cell, dropped, opened
from .convergence import converge, error_row
from .figures import Figures, Show
from .stages import PARTS

SIZE_PX = (206, 154)
FEWEST = 4
REFERENCE_FACTOR = 4  # ratio of the reference's samples to the largest number of samples
ONE_BAND_FACTOR = 16  # the same ratio for the table of one band
WITH_SENSOR = 16  # number of samples at which sensor noise is added, near the paper's 20
BAD_SHARE_LIMIT = 0.01  # largest share of bad pixels at the recommended number of samples


def measure(*, samples: int, show: Show) -> Figures:
    with opened(1, 3) as renderers:
        return study(*renderers, count=PARTS, most=samples, size_px=SIZE_PX, show=show)


def study(
    mitsuba: Renderer,
    cycles: Renderer,
    converging: Renderer,
    *,
    count: int,
    most: int,
    size_px: tuple[int, int],
    show: Show,
) -> Figures:
    """Measure errors of decoded depth for several numbers of samples and denoisers.

    Args:
        converging: Cycles with three patterns per render, for the reference in one band.
        count: number of brackets in the box.
        most: the largest number of samples; the reference has `REFERENCE_FACTOR` times as many.
    """
    cell = bracket_cell(count, GRAY, size_px, rig="paper")
    red = bracket_cell(count, GRAY, size_px, rig="like-phoxi-m")
    layout = dropped(cell, count, seed=0)
    counts = sample_counts(most)
    rows: list[Figures] = []
    noisy: list[Figures] = []
    converged = REFERENCE_FACTOR * counts[-1]
    few = (min(WITH_SENSOR, counts[-1]),)
    for renderer in (mitsuba, cycles):
        ends = _series(cell, layout, renderer, renderer, counts, converged, show)
        rows += ends[0]
        noisy += ends[1]
    show("light of one band")
    one_band, _ = _series(red, layout, cycles, converging, few, ONE_BAND_FACTOR * few[0], show)
    devices = {one.name: one.device for one in (mitsuba, cycles)}
    return {
        "devices": devices,
        "parts": count,
        "width_px": size_px[0],
        "height_px": size_px[1],
        "patterns": len(cell.code.frames),
        "reference_samples": converged,
        "rows": rows,
        "with_sensor_noise": noisy,
        "in_one_band": one_band,
        "recommended": [recommended(rows, name) for name in devices],
    }


def sample_counts(most: int) -> tuple[int, ...]:
    """Return 4, 8, 16 .. `most`.

    Raises:
        ValueError: `most` is less than `FEWEST`.
    """
    if most < FEWEST:
        raise ValueError(
            f"samples is {most}; {FEWEST} or more are needed, because the series starts there"
        )
    counts = [FEWEST]
    while 2 * counts[-1] <= most:
        counts.append(2 * counts[-1])
    return tuple(counts)


def denoisers(renderer: Renderer) -> tuple[DenoiserName, ...]:
    """Return the denoisers that run on the device of a renderer."""
    gpu = renderer.name == "cycles" and renderer.device != "cpu"
    return ("none", "oidn", "optix") if gpu else ("none", "oidn")


def recommended(rows: list[Figures], renderer: str) -> Figures:
    """Return the best denoiser for a renderer, and the number of samples that it needs.

    The denoiser has the smallest share of bad pixels near the paper's number of samples. It needs
    the smallest number of samples from which on the share is within the limit, or None.
    """
    own = [row for row in rows if row["renderer"] == renderer]
    near = min({row["samples"] for row in own}, key=lambda n: abs(n - WITH_SENSOR))
    best = min((row for row in own if row["samples"] == near), key=lambda row: row["bad_share"])
    fewest = None
    for row in sorted(own, key=lambda row: -row["samples"]):
        if row["denoise"] == best["denoise"]:
            if row["bad_share"] > BAD_SHARE_LIMIT:
                break
            fewest = row["samples"]
    words = ("renderer", "denoise", "bad_share")
    return {word: best[word] for word in words} | {"bad_share_at": near, "samples": fewest}


def _series(
    cell: Cell,
    layout: Layout,
    renderer: Renderer,
    for_reference: Renderer,
    counts: tuple[int, ...],
    converged: int,
    show: Show,
) -> tuple[list[Figures], list[Figures]]:
    rows, noisy = [], []
    reference = converge(cell, layout, for_reference, converged, show)
    for denoise in denoisers(renderer):
        for samples in counts:
            sensors = (SensorSpec(),) if samples == WITH_SENSOR else ()
            row, taken = error_row(reference, renderer, samples, denoise, show, sensors=sensors)
            rows.append(row)
            noisy += taken
    return rows, noisy
