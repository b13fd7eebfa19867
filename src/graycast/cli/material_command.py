"""The command real material, which fits the material of parts to one scan."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import add_command, add_option, add_out, add_shared, resolve_rig_option
from .readers import above_zero

# Heavy modules are imported by the command, so that --help answers at once.

MATERIAL = """\
The surface is metal or plastic, with a base colour and a roughness. The command compares the
projector's direct light in each pixel with the renderer's own model of surfaces at the directions
of camera and projector, and states a 95 % interval for each number. It writes the material as a
YAML file, whose keys fit into the section material of a configuration, and a plot of the measured
and the fitted light next to it. The mottle, such as the grain of blasted metal, is fitted, too, but
not to the scans of a laser. Metal needs --reference, because its base colour and the intensity
of the projector change the light in the same way. Grooves, films and glass are not fitted.

Without --mask, the command divides the pixels into one to three classes of one material each. If
there are several, it fits each but that of --reference, which is known. It writes material_1.yaml,
material_2.yaml and so on, with material_classes.png, a picture of the classes. A smooth surface
counts as one material, so a print is no class of its own."""


def add_material(group) -> None:
    material = add_command(
        group, "material", _material, "Fit the material of parts to one scan of them.",
        example="stack.yaml --rig rig.yaml --mask parts.png --out material.yaml", more=MATERIAL,
    )  # fmt: skip
    stack = "The stack file, which describes each picture, or a folder that holds a stack.yaml."
    add_option(material, "stack", Path, stack)
    add_shared(material, "--rig", usual="the rig that the stack file names")
    add_shared(material, "--resolution", usual="low")
    add_option(
        material, "--mask", Path,
        "PNG masks of the pictures' size, 255 where the parts of one material are and 0 elsewhere.",
        usual="the command divides all pixels into classes", nargs="+", metavar="PNG",
    )  # fmt: skip
    add_option(
        material, "--reference", Path,
        "PNG masks of a matt surface with a known reflectance in the same scan, such as a white "
        "sheet.", nargs="+", metavar="PNG",
    )  # fmt: skip
    add_option(
        material, "--reflectance", above_zero,
        "The reflectance of the surface of --reference at the projector's wavelength, from 0 to 1.",
        metavar="SHARE",
    )  # fmt: skip
    add_option(
        material, "--metal", None,
        "The surface is known to be metal: fit also the share of the light that it scatters, as a "
        "blasted or anodised metal does.",
    )  # fmt: skip
    add_out(material, "The YAML file to write, which must be new.")
    add_shared(material, "--seed", default=0)


def _material(options: argparse.Namespace) -> None:
    from ..base.folder import whole_folder
    from ..real.fitted_config import refuse_there
    from ..real.material.classes import MOST_CLASSES

    if (options.reference is None) != (options.reflectance is None):
        raise GraycastError("--reference and --reflectance belong together: give both or neither")
    if options.reflectance is not None and options.reflectance > 1:
        raise GraycastError(f"--reflectance is {options.reflectance:g}: give a share from 0 to 1")
    if options.rig is None and options.resolution is not None:
        raise GraycastError("--resolution applies only to a preset: add --rig, or remove it")
    names = [options.out]
    if options.mask is None:
        names += [_numbered(options.out, number) for number in range(MOST_CLASSES)]
        names.append(_classes_path(options.out))
    files = [*names, *(name.with_suffix(".png") for name in names)]
    refuse_there(*files)
    # The files appear together at the end, because the files of a killed run would block the next.
    with whole_folder(options.out.parent) as folder:
        _write(options, folder)
        written = [options.out.with_name(entry.name) for entry in sorted(folder.iterdir())]
        refuse_there(*files)  # Another process may have written the files meanwhile.
    print()
    for path in written:
        print(path)


def _write(options: argparse.Namespace, folder: Path) -> None:
    """Fit the material, or that of each class, and write the files to a folder."""
    import numpy as np

    from ..real.material import divide, open_scan, read_masks

    mask = None if options.mask is None else read_masks(options.mask)
    white = None if options.reference is None else read_masks(options.reference)
    scan = open_scan(options.stack, None if options.rig is None else resolve_rig_option(options))
    for warning in scan.result.warnings:
        print(f"warning: {warning}")
    scale = None
    if white is not None:
        scale = scan.scale(white, options.reflectance)
    if lost := scan.saturated_pixels(mask):
        print(f"note: {lost} saturated pixels are left out: no depth between them shows a plane")
    if mask is None:
        observations = scan.observations()
        division = divide(observations, scale=scale, seed=options.seed)
        if division.count > 1:
            _fit_classes(
                options, scan, observations, division, scale=scale, white=white, folder=folder
            )
            return
        print("one class: all pixels agree with one material")
        mask = None if white is None else ~white
    area = np.ones(scan.surface_m.shape, dtype=bool) if mask is None else mask
    out = folder / options.out.name
    _fit(options, scan, scan.observations(mask), area, scale=scale, out=out)


def _numbered(out: Path, number: int) -> Path:
    return out.with_name(f"{out.stem}_{number + 1}{out.suffix}")


def _classes_path(out: Path) -> Path:
    return out.with_name(f"{out.stem}_classes.png")


def _fit_classes(
    options: argparse.Namespace, scan, observations, division, *, scale, white, folder: Path
) -> None:
    """Write the material of each class and the picture of the classes.

    The class with most pixels of the reference is matt and has the stated reflectance.

    Raises:
        GraycastError: no class can be fitted.
    """
    import numpy as np

    from ..base.folder import write_whole
    from ..real.material import classes_picture, describe_class, matt_text, scale_of

    reference = None if white is None else division.most(white[tuple(observations.pixel.T)])
    refusals = []
    print(f"{division.count} classes of material")
    for number in range(division.count):
        print(f"\n{describe_class(observations, division, number)}")
        members = observations.part(np.flatnonzero(division.members(number)))
        area = np.zeros(scan.surface_m.shape, dtype=bool)
        area[tuple(members.pixel.T)] = True
        out = folder / _numbered(options.out, number).name
        if number == reference:
            matt = scale_of(members, options.reflectance) / scale * options.reflectance
            print(f"the surface of --reference; as a matt surface, the class reflects {matt:.3f}")
            write_whole(out, matt_text(options.reflectance, _source(options, scan)).encode())
            continue
        try:
            _fit(options, scan, members, area, scale=scale, out=out)
        except GraycastError as error:
            print(f"note: no material: {error}")
            refusals.append(error)
    if len(refusals) == division.count - (reference is not None):
        raise refusals[0]
    path = folder / _classes_path(options.out).name
    write_whole(path, classes_picture(scan.result.light[0], observations, division))


def _source(options: argparse.Namespace, scan) -> str:
    nm = 1e9 * scan.scanner.sensor.wavelength_m
    return f"{options.stack.as_posix()}, scanned by {scan.scanner.rig.name} with {nm:.0f} nm"


def _fit(options: argparse.Namespace, scan, observations, area, *, scale, out: Path) -> None:
    """Write the material of some pixels and its plot; `area` marks the pixels that show mottle."""
    from ..base.folder import write_whole
    from ..real.material import describe_fit, draw_fit, fit_material, material_text

    fit = fit_material(observations, scale=scale, metal=options.metal, seed=options.seed)
    mottle = None
    try:
        mottle = scan.mottle(area, seed=options.seed)
    except GraycastError as error:
        print(f"note: mottle is not fitted: {error}")
    print("\n".join(describe_fit(fit, mottle)))
    write_whole(out, material_text(fit, _source(options, scan), mottle).encode())
    draw_fit(fit, observations, out.with_suffix(".png"))
