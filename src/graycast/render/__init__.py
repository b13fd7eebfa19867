"""Light transport: one file per back end, and a small exact reference."""

from .radiance import GroundTruth, Quality, Radiance, Renderer, Rendering, Silhouette

__all__ = [
    "GroundTruth",
    "Quality",
    "Radiance",
    "Renderer",
    "Rendering",
    "Silhouette",
    "open_renderer",
]


def open_renderer(name: str) -> Renderer:
    """The one place that knows which back ends exist; each is imported when asked for.

    'mitsuba' needs `render.device.open_device` first, which chooses CPU or GPU.
    """
    match name:
        case "reference":
            from .reference import ReferenceRenderer as Chosen
        case "mitsuba":
            from .mitsuba import MitsubaRenderer as Chosen
        case _:
            raise ValueError(f"no renderer {name!r}: choose 'reference' or 'mitsuba'")
    return Chosen()
