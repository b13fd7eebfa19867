"""Names of the networks and of their inputs, from which the command line takes its choices.

PyTorch, which takes seconds to load and may be missing, is imported with a network.
"""

from typing import TYPE_CHECKING

from ...base.errors import GraycastError

if TYPE_CHECKING:
    from .network import Network

MODELS = ("mask-rcnn", "yolov3", "solov2", "yolov7", "rf-detr")
INPUTS = ("rgb", "depth", "depth_sl", "depth_noisy", "rgbd")
HOLES = ("channel", "zero", "far")  # how missing depth is encoded


def network_class(model: str) -> "type[Network]":
    """The class of a model's networks; to make one raises GraycastError if its library is missing.

    Raises:
        GraycastError: no such model.
    """
    match model:
        case "mask-rcnn":
            from .mask_rcnn import MaskRcnn as Choice
        case "yolov3":
            from .yolov3 import Yolov3 as Choice
        case "solov2":
            from .solov2 import Solov2 as Choice
        case "yolov7":
            from .yolov7 import Yolov7 as Choice
        case "rf-detr":
            from .rf_detr import RfDetr as Choice
        case _:
            raise GraycastError(
                f"the model {model!r} does not exist: choose one of {', '.join(MODELS)}"
            )
    return Choice
