"""The files of a certificate: JSON, plots, and a web page that resembles a datasheet."""

import base64
import json
import math
from html import escape
from pathlib import Path

from .certificate import Certificate, PlaneResult
from .certificate_plots import draw_plots

CERTIFICATE = "certificate.json"
REMARK = (
    "Figures of a simulated camera. The quantities are named after those of VDI/VDE 2634 part 2; "
    "conformity with the guideline is not claimed."
)


def write_certificate(certificate: Certificate, out: Path) -> Path:
    """Write `certificate.json`, the plots as PNGs and `certificate.html` into a folder.

    The page is one file with embedded pictures; it needs neither scripts nor a network.

    Returns:
        The path of the page.
    """
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(certificate.record(), indent=2, allow_nan=False)
    (out / CERTIFICATE).write_text(text + "\n", encoding="utf-8")
    plots = draw_plots(certificate, out)
    page = out / "certificate.html"
    page.write_text(_page(certificate, plots), encoding="utf-8")
    return page


def describe(certificate: Certificate) -> str:
    """Return the figures of the datasheet as text, one per line, with lengths in mm."""
    lines = [f"{name:34} {value:>18}" for name, value, _ in _figures(certificate)]
    lines.append(f"{certificate.scenes} scenes in {certificate.seconds:.0f} s")
    return "\n".join(lines)


def _figures(certificate: Certificate) -> list[tuple[str, str, str]]:
    """Return name, value and method of measurement of each figure on the datasheet."""
    c, s = certificate, certificate.summary
    near, middle, far = c.facing[0], c.middle, c.facing[-1]
    ends = f"{1e3 * near.z_m:.0f} / {1e3 * middle.z_m:.0f} / {1e3 * far.z_m:.0f} mm"
    captures, albedo = c.conditions["captures"], c.conditions["albedo"]
    return [
        (
            "Temporal noise (1 sigma)",
            _mm(s["temporal_noise_m"]),
            f"Depth of a pixel over {captures} shots of a facing plane at "
            f"{1e3 * middle.z_m:.0f} mm, diffuse {albedo:.0%} albedo; median over the middle.",
        ),
        (
            "Temporal noise, near / far",
            f"{_number(near.noise_m)} / {_mm(far.noise_m)}",
            f"The same at {1e3 * near.z_m:.0f} and {1e3 * far.z_m:.0f} mm.",
        ),
        (
            "Error over stated sigma",
            _range([plane.error_m / plane.sigma_m for plane in c.planes]),
            "Standard deviation of measured less true depth from pixel to pixel in one shot, over "
            "the median sigma that the scanner states there; least and largest of the poses. "
            "Both have errors that are fixed, as a device's raster on steep surfaces, which the "
            "temporal noise has not.",
        ),
        (
            "Flatness error",
            _mm(s["flatness_error_m"]),
            "Range of signed distances from the best-fit plane over the whole common field, in a "
            f"single shot; largest of {len(c.planes)} poses.",
        ),
        (
            "Standard deviation about a plane",
            _mm(s["plane_std_m"]),
            "Of the same distances, largest of the same poses.",
        ),
        (
            "Probing error, form (PF)",
            _mm(s["probing_form_m"]),
            f"Range of radial distances from the best-fit sphere of "
            f"{1e3 * c.probing_diameter_m:.0f} mm; largest of {len(c.probing)} places.",
        ),
        (
            "Probing error, size (PS)",
            _mm(s["probing_size_m"], sign=True),
            "Fitted less true diameter of the same spheres; worst.",
        ),
        (
            "Sphere-spacing error (SD)",
            _mm(s["sphere_spacing_m"], sign=True),
            f"Measured less true distance of two spheres of {1e3 * c.bar_diameter_m:.0f} mm, "
            f"{1e3 * c.bar_length_m:.0f} mm apart; worst of {len(c.spacing)} positions.",
        ),
        (
            "Point spacing, near / middle / far",
            f"{_number(near.spacing_m)} / {_number(middle.spacing_m)} / {_mm(far.spacing_m)}",
            f"Median lateral distance of neighbouring points at {ends}.",
        ),
    ]


def _range(ratios: list[float]) -> str:
    return f"{min(ratios):.2f} to {max(ratios):.2f}"


def _mm(length_m: float, *, sign: bool = False) -> str:
    return f"{_number(length_m, sign=sign)} mm"


def _number(length_m: float, *, sign: bool = False) -> str:
    """Return a length in mm as text with three digits."""
    if not math.isfinite(length_m):
        return "n/a"
    value = 1e3 * length_m
    decimals = max(0, min(6, 2 - math.floor(math.log10(abs(value))))) if value else 3
    text = f"{value:+.{decimals}f}" if sign else f"{value:.{decimals}f}"
    return text.replace("-", "\N{MINUS SIGN}")


def _page(certificate: Certificate, plots: dict[str, Path]) -> str:
    name = escape(str(certificate.rig["name"]))
    rows = "\n".join(
        f"<tr><th>{escape(what)}</th><td class=value>{escape(value)}</td>"
        f"<td>{escape(how)}</td></tr>"
        for what, value, how in _figures(certificate)
    )
    facts = "\n".join(
        f"<div><dt>{escape(word)}</dt><dd>{escape(text)}</dd></div>"
        for word, text in _facts(certificate)
    )
    encoded = {key: base64.b64encode(path.read_bytes()).decode() for key, path in plots.items()}
    pictures = {
        key: f'<img alt="{escape(alt)}" src="data:image/png;base64,{encoded[key]}">'
        for key, alt in _ALTERNATIVES.items()
    }
    method = "\n".join(f"<li>{escape(line)}</li>" for line in _method(certificate))
    limits = "\n".join(f"<li>{escape(line)}</li>" for line in _limits(certificate))
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{name}: certificate of a virtual camera</title>
<style>{_STYLE}</style>
</head>
<body>
<main>
<header><p>Graycast · virtual 3D camera</p><h1>{name}</h1>
<p class=remark>{escape(REMARK)}</p></header>
<dl>
{facts}
</dl>
<h2>Accuracy and precision</h2>
<table class=figures>
{rows}
</table>
<h2>Noise</h2>
{pictures["noise"]}
<h2>Shape and length</h2>
{pictures["shape"]}
{_plane_table(certificate.planes)}
<h2>Focus and contrast</h2>
{pictures["focus"]}
<h2>Where it was measured</h2>
{pictures["volume"]}
<section class=columns>
<div><h2>How it was measured</h2><ul>
{method}
</ul></div>
<div><h2>What the figures leave out</h2><ul>
{limits}
</ul></div>
</section>
<footer>{certificate.scenes} scenes, {certificate.seconds:.0f} s,
{escape(str(certificate.conditions["renderer"]))}, seed {certificate.conditions["seed"]}</footer>
</main>
</body>
</html>
"""


def _facts(certificate: Certificate) -> list[tuple[str, str]]:
    rig, conditions = certificate.rig, certificate.conditions
    camera, projector = rig["camera"], rig["projector"]
    fields = ", ".join(
        f"{name} {1e3 * w:.0f} x {1e3 * h:.0f}" for name, (w, h) in certificate.field_m.items()
    )

    def on(section: str) -> str:
        words = [f"{name} {value:g}" for name, value in conditions[section].items() if value]
        return ", ".join(words).replace("_", " ") or "none"

    return [
        ("Working range", f"{1e3 * certificate.near_m:.0f} to {1e3 * certificate.far_m:.0f} mm"),
        ("Common field", f"{fields} mm"),
        ("Baseline", f"{1e3 * rig['baseline_m']:.1f} mm"),
        ("Angle of the axes", f"{math.degrees(rig['axes_angle_rad']):.2f} deg"),
        ("Camera", f"{camera['width_px']} x {camera['height_px']} px, f {camera['fx_px']:.0f} px"),
        (
            "Projector",
            f"{projector['width_px']} x {projector['height_px']} px, f {projector['fx_px']:.0f} px",
        ),
        ("Code", f"{conditions['code']['codec']}, {conditions['code']['frames']} frames"),
        (
            "Exposure at the middle",
            " + ".join(f"{1e3 * time_s:.3g}" for time_s in certificate.middle.exposures_s)
            + " ms a frame"
            + (", chosen automatically" if conditions["exposures"] == "automatic" else ""),
        ),
        ("Depth filters", on("filters")),
        ("Simulated faults", on("faults")),
    ]


def _plane_table(planes: tuple[PlaneResult, ...]) -> str:
    rows = "\n".join(
        f"<tr><th>{escape(plane.name)}</th>"
        + "".join(
            f"<td>{text}</td>"
            for text in (
                _number(plane.flatness_m),
                _number(plane.std_m),
                _number(plane.offset_m, sign=True),
                _number(plane.noise_m),
                _number(plane.error_m),
                _number(plane.sigma_m),
                f"{100 * plane.decoded_share:.2f}",
                f"{plane.points:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"),
            )
        )
        + "</tr>"
        for plane in planes
    )
    heads = ("flatness", "std. dev.", "offset", "noise", "error", "sigma", "decoded %", "points")
    return (
        "<table class=planes><thead><tr><th>plane, mm</th>"
        + "".join(f"<th>{head}</th>" for head in heads)
        + f"</tr></thead><tbody>\n{rows}\n</tbody></table>"
    )


def _method(certificate: Certificate) -> list[str]:
    c = certificate
    box = f"{1e3 * c.diagonal_m:.0f} mm"
    return [
        "Artefacts are exact planes and spheres, perfect diffusers, alone in the dark; "
        "light is path traced, then passes lens, sensor, decoder and filters.",
        f"The space diagonal of the box around the working volume is {box}. Probing sphere "
        f"{c.probing_diameter_m / c.diagonal_m:.2f}, ball bar {c.bar_length_m / c.diagonal_m:.2f}, "
        f"its spheres {c.bar_diameter_m / c.diagonal_m:.2f} of it.",
        "Fits are least squares of orthogonal distances; a sphere's radius is free. The worst 3 "
        "points in 1000 are dropped after a first fit, and the fit is made again.",
        "Planes fill the common field of camera and projector, less 3 pixels of outline; spheres "
        "count up to 60 deg of incidence to either device.",
        "Spheres of one depth may stand in one scene where none hides another; exposure is metered "
        "on the artefacts.",
        "Modulation: pattern less inverse over white less black, of phases twice the amplitude "
        "over it, from light without noise in the middle of a facing plane. Blur: closed form of "
        "a thin lens.",
    ]


def _limits(certificate: Certificate) -> list[str]:
    lines = [
        "Temporal noise is the sensor's alone: one rendering is taken again with other noise. "
        "Vibration, drift, warm-up and a projector that flickers would add to it.",
        "Errors of the artefacts and of their calibration are nil; those of the rig's calibration "
        + (
            "are in the figures: the scanner decodes with another rig than the light was traced "
            "with."
            if certificate.conditions["calibration_differs"]
            else "are nil too: the scanner knows its rig exactly."
        ),
        "Range errors (flatness, PF) grow with the number of points and with noise.",
        "Shiny, dark or translucent surfaces measure worse.",
        f"Light is sampled by {certificate.conditions['samples']} paths a pixel, each of which "
        "sees a projector pixel or a few: a fixed pattern adds to form, not to temporal noise.",
    ]
    if not certificate.conditions["code"]["subpixel"]:
        lines.append(
            "The code tells whole projector pixels: most points repeat exactly from shot to shot, "
            "so temporal noise says little; the deviation about a plane holds the steps."
        )
    if certificate.conditions["path_vertices"] == 1:
        lines.append("Light is direct: interreflections between artefacts are left out.")
    return lines


_ALTERNATIVES = {
    "noise": "temporal noise, error of one shot and stated sigma against distance and tilt",
    "shape": "deviation map of the middle plane, probing errors, sphere-spacing errors",
    "focus": "modulation per bit and blur against distance",
    "volume": "places of the artefacts from above and from the side",
}

_STYLE = """
:root { color: #1f2933; font: 10.5pt/1.45 "Helvetica Neue", Helvetica, Arial, sans-serif; }
body { margin: 0; background: #f0f2f4; }
main { max-width: 210mm; margin: 8mm auto; padding: 14mm 16mm; background: #fff; }
header { border-bottom: 2px solid #0b6e99; padding-bottom: 3mm; margin-bottom: 5mm; }
header p { margin: 0; color: #52606d; letter-spacing: .02em; }
h1 { margin: 0 0 1mm; font-size: 25pt; font-weight: 300; letter-spacing: -.01em; }
h2 { margin: 7mm 0 2mm; font-size: 10.5pt; color: #0b6e99; font-weight: 600; }
.remark { font-size: 9pt; }
dl { display: grid; grid-template-columns: repeat(3, 1fr); gap: 3mm 6mm; margin: 0; }
dt { font-size: 8.5pt; color: #616e7c; }
dd { margin: 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 500; }
th, td { padding: 1.4mm 2mm 1.4mm 0; border-bottom: 1px solid #e4e7eb; vertical-align: top; }
.figures td { font-size: 9pt; color: #52606d; }
.figures td.value { font-size: 10.5pt; font-weight: 600; color: #1f2933; white-space: nowrap;
  padding-right: 6mm; }
.figures th { white-space: nowrap; padding-right: 6mm; }
.planes { font-size: 8.5pt; }
.planes th, .planes td { padding: .8mm 2mm .8mm 0; }
.planes td, .planes thead th:not(:first-child) { text-align: right; }
.planes thead th { color: #616e7c; }
img { width: 100%; height: auto; display: block; }
.columns { display: grid; grid-template-columns: 1fr 1fr; gap: 8mm; font-size: 9pt; }
ul { margin: 0; padding-left: 4mm; }
li { margin-bottom: 1mm; }
footer { margin-top: 7mm; font-size: 8.5pt; color: #616e7c; }
@media print { body { background: #fff; } main { margin: 0; padding: 0; }
  h2, img, tr { break-inside: avoid; } h2 { break-after: avoid; } }
@page { size: A4; margin: 14mm; }
"""
