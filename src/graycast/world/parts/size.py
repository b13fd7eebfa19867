"""The mass of a part, and checks that its size and mass suit a part in a bin."""

from collections.abc import Iterable

import numpy as np
from scipy.spatial import ConvexHull

from .part import Part

# A gripper for bin picking lifts less; a steel cube of this weight is 15 cm wide.
HEAVIEST_KG = 30.0
USUAL_M = (0.004, 0.5)  # The usual longest side of parts for bin picking.
PACKING = 0.5  # This share of a full bin is inside the convex hulls of its parts.


def mass_kg(part: Part) -> float:
    """Return the mass of the part as a solid: density times the volume that its mesh encloses.

    Source: divergence theorem; the signed volumes of tetrahedra from the origin to each face.
    """
    corner = part.mesh.vertices_m[part.mesh.faces] - part.mesh.bounds_m[0]
    a, b, c = np.moveaxis(corner, 1, 0)
    volume_m3 = np.einsum("fi,fi->", a, np.cross(b, c)) / 6
    return float(part.density_kg_m3 * volume_m3)


def size_text(part: Part) -> str:
    """Return the sizes of the part along its axes in millimetres."""
    return " x ".join(f"{1e3 * size:.1f}" for size in part.mesh.extent_m)


def mass_text(part: Part) -> str:
    """Return the mass of the part in grams or kilograms."""
    mass = mass_kg(part)
    if mass >= 100:
        return f"{mass:.0f} kg"
    return f"{mass:.3g} kg" if mass >= 1 else f"{1e3 * mass:.3g} g"


def unusual_size_note(part: Part) -> str:
    """Return a remark on a part that is unusually short or long for a part in a bin, else ""."""
    low_m, high_m = USUAL_M
    longest_m = float(part.mesh.extent_m.max())
    if low_m <= longest_m <= high_m:
        return ""
    return (
        f"the part {part.name} is {1e3 * longest_m:.4g} mm long, and most parts in bins are "
        f"{1e3 * low_m:g} to {1e3 * high_m:g} mm long: is this the unit of its mesh?"
    )


def full_count(part: Part, inner_m: tuple[float, float, float]) -> float:
    """Return the number of parts that fill a bin of these inner sizes as a loose heap."""
    return PACKING * float(np.prod(inner_m)) / float(ConvexHull(part.mesh.vertices_m).volume)


def size_notes(parts: Iterable[Part], inner_m: tuple[float, float, float]) -> tuple[str, ...]:
    """Return notes on parts that are longer than the bin's inner diagonal, or implausibly heavy.

    The usual cause is a wrong `unit`, which most mesh files do not state.
    """
    room_m = float(np.linalg.norm(inner_m))
    notes = []
    for part in parts:
        longest_m, mass = float(part.mesh.extent_m.max()), mass_kg(part)
        if longest_m > room_m:
            why = (
                f"is {1e3 * longest_m:.0f} mm long, and the diagonal of the bin is "
                f"{1e3 * room_m:.0f} mm"
            )
        elif mass > HEAVIEST_KG:
            why = f"is {1e3 * longest_m:.0f} mm long and weighs {mass:.0f} kg"
        else:
            continue
        notes.append(f"the part {part.name} {why}: check its unit, and its density_kg_m3")
    return tuple(notes)
