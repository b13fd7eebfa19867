"""Names of the networks and of their inputs, for the choices of the command line.

PyTorch is slow to import and may be missing, so it is imported only with a network.
"""

from typing import TYPE_CHECKING

from ...base.errors import GraycastError

if TYPE_CHECKING:
    from .network import Network

MODELS = ("mask-rcnn", "yolov3", "solov2", "yolov7")
RF_DETR = (
    "rf-detr is now an example of a network of your own: train it, and read detectors that were "
    "trained earlier, with examples/09_own_detector.py of the repository"
)
INPUTS = ("rgb", "depth", "depth_sl", "depth_noisy", "rgbd")
HOLES = ("channel", "zero", "far")  # how missing depth is encoded


def network_class(model: str) -> "type[Network]":
    """Return the class of a network; its constructor reports a missing library.

    Raises:
        GraycastError: the model does not exist.
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
            raise GraycastError(RF_DETR)
        case _:
            raise GraycastError(
                f"the model {model!r} does not exist: choose one of {', '.join(MODELS)}, or pass a "
                "class of your own as the argument network"
            )
    return Choice
