"""Which networks there are; each is imported when it is asked for.

The command line repeats their names, since this module imports PyTorch.
"""

from ...base.errors import GraycastError
from .network import Network, NetworkClass

MODELS = ("mask-rcnn", "yolov3", "solov2", "yolov7", "rf-detr")


def open_network(
    model: str, *, channels: int, classes: int, backbone: str | None, size_px: tuple[int, int]
) -> Network:
    """A network with random weights, drawn from torch's global generator.

    Args:
        model: one of `MODELS`.
        channels: of the input.
        classes: of parts; what is none of them is no class.
        backbone: one that the model knows; its own choice where it is None.
        size_px: height and width of the input, multiples of 32.

    Raises:
        GraycastError: no such model or backbone, or a library of it is not installed.
    """
    chosen = network_class(model)
    return chosen(channels=channels, classes=classes, backbone=backbone, size_px=size_px)


def network_class(model: str) -> NetworkClass:
    """What a model's networks are, and whether they find masks.

    Raises:
        GraycastError: no such model.
    """
    match model:
        case "mask-rcnn":
            from .mask_rcnn import MaskRcnn as Chosen
        case "yolov3":
            from .yolov3 import Yolov3 as Chosen
        case "solov2":
            from .solov2 import Solov2 as Chosen
        case "yolov7":
            from .yolov7 import Yolov7 as Chosen
        case "rf-detr":
            from .rf_detr import RfDetr as Chosen
        case _:
            raise GraycastError(
                f"the model {model!r} does not exist: choose one of {', '.join(MODELS)}"
            )
    return Chosen
