"""Non-maximum suppression for detectors of boxes."""

from jaxtyping import Float
from torch import Tensor
from torchvision.ops import batched_nms

from .network import NetworkOutput

OVERLAP = 0.45


def best_boxes(
    box: Float[Tensor, "n 4"],
    score: Float[Tensor, "n classes"],
    *,
    most: int,
    least_score: float,
    size_px: tuple[int, int],
) -> NetworkOutput:
    """Return the boxes that remain after suppression within each class, clipped to the picture.

    Args:
        box: candidate boxes, each for every class.
        score: score of each candidate and class; 0 means that it is not a candidate.
        most: largest number of detections; ten times as many candidates are compared.
        least_score: lowest score of a detection.
        size_px: height and width of the picture.
    """
    best, place = score.flatten().topk(min(10 * most, score.numel()))
    wanted = (best >= least_score) & (best > 0)
    best, place = best[wanted], place[wanted]
    box, label = box[place // score.shape[1]], place % score.shape[1]
    index = batched_nms(box, best, label, OVERLAP)[:most]
    height, width = size_px
    inside = box[index].clamp(min=0).minimum(box.new_tensor([width, height, width, height]))
    return NetworkOutput(box=inside, label=label[index], score=best[index], mask=None)
