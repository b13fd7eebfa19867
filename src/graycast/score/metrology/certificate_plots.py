"""Plots of a certificate."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...base.plotting import ACCENT, INK, SECOND, SOFT, caption, plain_figure, save_png
from .certificate import Certificate

DEPTH_COLORS = ("#5aa9c7", ACCENT, "#0a3d56")
MAP_SIGMAS = 3.0  # limit of the colour scale, as a multiple of the plane's standard deviation


def draw_plots(certificate: Certificate, folder: Path) -> dict[str, Path]:
    """Write all plots as PNGs into an existing folder, and return their paths by name.

    Raises:
        GraycastError: a file cannot be written.
    """
    figures = {
        "volume": _volume(certificate),
        "noise": _noise(certificate),
        "shape": _shape(certificate),
        "focus": _focus(certificate),
    }
    paths = {}
    for name, figure in figures.items():
        paths[name] = folder / f"{name}.png"
        save_png(figure, paths[name], dpi=150)
    return paths


def _volume(certificate: Certificate) -> Figure:
    """Return a plot of the artefacts' positions, from above and from the side."""
    figure, axes = plain_figure(9.6, 4.2, (1, 1))
    for ax, across, letter in zip(axes, (0, 1), "xy", strict=True):
        for plane in certificate.facing:
            ax.axhline(1e3 * plane.z_m, color=SOFT, lw=0.8, zorder=1)
        for bar in certificate.spacing:
            ends = 1e3 * np.array(bar.ends_m)
            style: dict[str, Any] = {"ms": 4, "lw": 1, "color": SECOND, "zorder": 3}
            ax.plot(ends[:, across], ends[:, 2], "o-", **style)
        turn = np.linspace(0, 2 * np.pi, 60)
        radius = 500 * certificate.probing_diameter_m
        for one in certificate.probing:
            x, z = 1e3 * one.centre_m[across], 1e3 * one.centre_m[2]
            ax.fill(x + radius * np.cos(turn), z + radius * np.sin(turn), color=ACCENT, alpha=0.5)
        for name, place in (
            ("camera", np.zeros(3)),
            ("projector", np.array(certificate.rig["projector_m"])),
        ):
            at = 1e3 * place[across], 1e3 * place[2]
            ax.plot(*at, "s", color=INK, ms=6)
            ax.annotate(
                name, at, (7, 3), textcoords="offset points", va="bottom", fontsize=8, color=INK
            )
        ax.set_aspect("equal")
        ax.invert_yaxis()
        view = {"x": "from above", "y": "from the side"}[letter]
        caption(ax, f"Artefacts {view}", f"{letter} [mm]", "depth z [mm]")
    handles = [
        axes[0].plot([], [], color=SOFT, lw=1, label="facing planes")[0],
        axes[0].plot([], [], "o", color=ACCENT, alpha=0.6, ms=8, label="probing spheres")[0],
        axes[0].plot([], [], "o-", color=SECOND, ms=4, lw=1, label="ball bar")[0],
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return figure


def _noise(certificate: Certificate) -> Figure:
    figure, (distance, tilt) = plain_figure(9.6, 2.9, (1, 1))
    rows = (
        (distance, certificate.facing, [1e3 * plane.z_m for plane in certificate.facing]),
        (tilt, certificate.tilted, [plane.tilt_deg for plane in certificate.tilted]),
    )
    for ax, planes, x in rows:
        stated = [1e3 * plane.sigma_m for plane in planes]
        errors = [1e3 * plane.error_m for plane in planes]
        noise = [1e3 * plane.noise_m for plane in planes]
        ax.plot(x, stated, "-", color=SOFT, lw=1.5, label="sigma that the scanner states")
        ax.plot(x, errors, "s", color=SECOND, ms=4, label="error of one shot")
        ax.plot(x, noise, "o", color=ACCENT, ms=5, label="noise from shot to shot")
        ax.set_ylim(bottom=0)
        ax.legend(fontsize=8, frameon=False)
    caption(distance, "Noise and error against distance", "distance [mm]", "1 sigma of depth [mm]")
    middle_mm = 1e3 * certificate.middle.z_m
    caption(
        tilt,
        f"Noise and error against tilt at {middle_mm:.0f} mm",
        "tilt about the baseline [deg]",
        "1 sigma of depth [mm]",
    )
    return figure


def _shape(certificate: Certificate) -> Figure:
    figure, (plane, sphere, bar) = plain_figure(9.6, 3.1, (1.25, 1, 0.8))
    deviation_mm = 1e3 * certificate.deviation_m
    limit_mm = MAP_SIGMAS * float(np.nanstd(deviation_mm)) or 1.0
    plane.grid(False)
    image = plane.imshow(deviation_mm, cmap="RdBu_r", vmin=-limit_mm, vmax=limit_mm)
    plane.set_xticks([])
    plane.set_yticks([])
    plane.spines[["left", "bottom"]].set_visible(False)
    color_bar = figure.colorbar(image, ax=plane, shrink=0.8, pad=0.02)
    color_bar.ax.tick_params(labelsize=8)
    color_bar.outline.set_visible(False)
    middle_mm = 1e3 * certificate.middle.z_m
    caption(plane, f"Plane at {middle_mm:.0f} mm less its fit [mm]", "", "")
    z_mm = [1e3 * one.centre_m[2] for one in certificate.probing]
    form_mm = [1e3 * one.form_m for one in certificate.probing]
    size_mm = [1e3 * one.size_m for one in certificate.probing]
    sphere.axhline(0, color=INK, lw=0.8)
    sphere.plot(z_mm, form_mm, "o", color=ACCENT, ms=5, label="form PF")
    sphere.plot(z_mm, size_mm, "D", color=SECOND, ms=4, label="size PS")
    sphere.legend(fontsize=8, frameon=False)
    caption(sphere, "Probing errors", "distance [mm]", "error [mm]")
    names = [one.name.replace("space diagonal", "space diag.") for one in certificate.spacing]
    names = [name.replace("diagonal of", "diag.") for name in names]
    bar.barh(names, [1e3 * one.error_m for one in certificate.spacing], color=ACCENT, height=0.55)
    bar.axvline(0, color=INK, lw=0.8)
    bar.invert_yaxis()
    bar.tick_params(axis="y", length=0)
    caption(bar, "Sphere spacing SD", "error [mm]", "")
    return figure


def _focus(certificate: Certificate) -> Figure:
    figure, (bits, blur) = plain_figure(9.6, 2.9, (1.2, 1))
    facing = certificate.facing
    planes = facing[0], certificate.middle, facing[-1]
    for name, plane, color in zip(("near", "middle", "far"), planes, DEPTH_COLORS, strict=True):
        values = list(plane.modulation.values())
        label = f"{name}, {1e3 * plane.z_m:.0f} mm"
        bits.plot(range(len(values)), values, "o-", color=color, ms=4, lw=1, label=label)
    labels = [_short(name) for name in certificate.middle.modulation]
    bits.set_xticks(range(len(labels)), labels, rotation=90 if len(labels) > 8 else 0, fontsize=7)
    bits.set_ylim(0, 1.05)
    bits.legend(fontsize=8, frameon=False, loc="lower left")
    caption(bits, "Modulation per bit, coarse to fine", "", "modulation")
    z_mm = [1e3 * one.z_m for one in certificate.blur]
    for name, color in (("camera", ACCENT), ("projector", SECOND)):
        radius_px = [getattr(one, f"{name}_px") for one in certificate.blur]
        blur.plot(z_mm, radius_px, color=color, lw=1.5, label=name)
    blur.set_ylim(bottom=0)
    blur.legend(fontsize=8, frameon=False)
    caption(blur, "Blur against distance", "distance [mm]", "radius of blur [own px]")
    return figure


def _short(name: str) -> str:
    """Return a short form of a frame's name for the axis; columns need no prefix."""
    for long, short in (
        ("column_", ""),
        ("row_", "row "),
        ("bit0", "bit "),
        ("complementary_", "compl. "),
        ("_step00", ""),
        ("phase_", "phase "),
        ("line_", "lines "),
        ("bit1", "bit 1"),
    ):
        name = name.replace(long, short)
    return name
