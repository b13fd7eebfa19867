"""Two distorted lenses, and the rays of one as OpenCV computes them."""

import cv2
import numpy as np

LENS = (-0.12, 0.05, 0.002, -0.001, 0.01)
BEAM = (0.15, -0.08, -0.003, 0.004, 0.02)


def opencv_rays(camera):
    """Return ray directions (h, w, 3) of pixel centres, with unit z, by OpenCV's own inverse."""
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    pixel = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    enough = (cv2.TERM_CRITERIA_MAX_ITER, 200, 0.0)
    ideal = cv2.undistortPoints(pixel, camera.K, np.array(camera.distortion), criteria=enough)
    return np.concatenate([ideal[:, 0], np.ones((x.size, 1))], axis=1).reshape(*x.shape, 3)
