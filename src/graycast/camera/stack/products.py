"""The files of a decoded stack, and its printed summary."""

import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...base.folder import refuse_foreign, whole_folder
from ...base.ply import cloud_bytes
from ..decode import Reason
from .decoding import Cloud, StackResult

CODE = "code.npz"  # Every result has this file.
PREVIEW = "preview.png"
FILES = (CODE, "light.npz", "depth.npy", "sigma_depth.npy", "p_wrong.npy", "cloud.ply", PREVIEW)


def write_result(result: StackResult, out: Path) -> tuple[Path, ...]:
    """Write the files of a result to a folder; each file is complete or does not appear.

    Files are first written to a temporary folder and then renamed one by one. Files of an
    earlier run that this run does not replace (such as depth, without a rig) are removed.

    Returns:
        The paths of the files.

    Raises:
        GraycastError: the folder cannot be written, or has other content.
    """
    refuse_foreign(out, CODE)
    with whole_folder(out) as aside:
        files = tuple(_write_all(result, aside))
    for name in set(FILES).difference(files):
        (out / name).unlink(missing_ok=True)
    return tuple(out / name for name in files)


def _write_all(result: StackResult, folder: Path) -> Iterator[str]:
    codes = result.codes
    if codes.mark is None:
        raise ValueError("the marks of this code map were not kept")
    _save_npz(
        folder / CODE,
        column=codes.column,
        row=codes.row,
        sigma_column=codes.sigma_column,
        sigma_row=codes.sigma_row,
        modulation=codes.modulation,
        reason=codes.reason,
        mark=codes.mark,
        reasons=np.array([reason.label for reason in Reason]),
    )
    yield CODE
    if result.light is not None:
        direct, indirect = result.light
        _save_npz(folder / "light.npz", **{"direct": direct, "global": indirect})
        yield "light.npz"
    if result.depth is not None:
        np.save(folder / "depth.npy", result.depth.depth_m)
        np.save(folder / "sigma_depth.npy", result.depth.sigma_m)
        yield from ("depth.npy", "sigma_depth.npy")
    if result.p_wrong is not None:
        np.save(folder / "p_wrong.npy", result.p_wrong)
        yield "p_wrong.npy"
    if result.cloud is not None:
        write_ply(result.cloud, folder / "cloud.ply")
        yield "cloud.ply"
    # Import here, so that only programs that draw have to load Matplotlib.
    from .stack_sheet import draw_sheet

    draw_sheet(result, folder / PREVIEW)
    yield PREVIEW


def _save_npz(path: Path, **arrays: np.ndarray) -> None:
    """Write an NPZ with fast compression; NumPy takes 4 times as long for files a tenth smaller."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)


def write_ply(cloud: Cloud, path: Path) -> None:
    """Write a binary PLY with x, y, z [m, camera frame], red, green, blue, and more properties.

    They are `pixels` for an averaged cloud, the number of averaged camera pixels (0: all
    uncertain), and `sigma` for any other cloud, the standard deviation of z [m], with `p_wrong`,
    the probability that z is wrong, if it was estimated.
    """
    more = {"pixels": cloud.sure_pixels, "sigma": cloud.sigma_m, "p_wrong": cloud.p_wrong}
    known = {name: column for name, column in more.items() if column is not None}
    path.write_bytes(cloud_bytes(cloud.point_m, cloud.color, more=known))


def describe_result(result: StackResult) -> str:
    """Return a summary of the result as lines of text, with warnings at the end."""
    figures = result.figures
    lines = [
        f"camera: {result.levels.source}",
        f"lit (frames differ by more than noise): {100 * figures.lit_share:.1f} % of the pixels",
        f"decoded: {100 * figures.decoded_share:.1f} % of the lit pixels",
    ]
    lines += [
        f"  {name.replace('_', ' '):18} {100 * share:6.2f} % of the pixels"
        for name, share in figures.reasons.items()
        if share
    ]
    for share, words in (
        (figures.clipped_share, "are saturated in a frame"),
        (figures.settled_share, "have a period that was resolved by their neighbours"),
    ):
        if share:
            lines.append(f"{100 * share:.2f} % of the decoded pixels {words}")
    lines.append("modulation (median over the better lit half of the decoded pixels):")
    lines += [f"  {name:28} {value:.3f}" for name, value in figures.modulation.items()]
    if np.isfinite(figures.epipolar_median_px):
        certain = ""
        if np.isfinite(figures.epipolar_sure_px):
            certain = f"; median {figures.epipolar_sure_px:.3f} px of pixels with no doubtful bit"
        lines.append(
            f"epipolar residual: median {figures.epipolar_median_px:.3f} px, 95 % under "
            f"{figures.epipolar_95_px:.3g} px{certain}"
        )
    if result.depth is not None:
        known = result.depth.depth_m[np.isfinite(result.depth.depth_m)]
        span = f", {known.min():.4f} to {known.max():.4f} m" if known.size else ""
        lines.append(f"depth: {known.size} pixels{span}")
    if result.cloud is not None:
        lines.append(f"cloud: {_count(result.cloud)}")
    took = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.seconds.items())
    lines.append(f"seconds: {took}")
    lines += [f"note: {note}" for note in result.notes]
    return "\n".join([*lines, *(f"warning: {warning}" for warning in result.warnings)])


def _count(cloud: Cloud) -> str:
    points = f"{len(cloud.point_m)} points"
    if cloud.sure_pixels is None:
        return points
    sure = int((cloud.sure_pixels > 0).sum())
    return f"{points}, one per projector pixel; {sure} of them of certain camera pixels"
