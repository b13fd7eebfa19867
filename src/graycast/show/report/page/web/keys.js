"use strict";
// The keys of a dataset's page, for its help.

Graycast.KEYS = {
  "All scenes": [
    ["← → ↑ ↓", "from scene to scene; Enter opens it"],
    ["/", "find scenes by number, part or tag"],
    ["x", "tick the scene; with shift, all from the last one"],
    ["g", "tag the ticked scenes"],
    ["Esc", "untick all"],
  ],
  "One scene": [
    ["1 … 9", "its views"],
    ["space", "back to the previous view"],
    ["c", "compare two views"],
    ["shift 1 … 8", "compare with that view"],
    ["v", "compare by swipe or side by side"],
    ["← →", "previous, next scene of the list"],
    ["m b", "masks, boxes"],
    ["d", "detections, if the page has any"],
    ["+ − 0", "zoom in, out, whole picture"],
    ["↑ ↓ or [ ]", "previous, next pattern frame"],
    ["p", "pattern frames: play, stop"],
    ["s p f w", "3D: perfect surface, scanner points, fused cloud, walls of the bin"],
    ["n", "the scene's next picture, if it has several"],
    ["x", "tick the scene"],
    ["g", "tag the scene"],
    ["Esc", "back to all scenes"],
  ],
  Everywhere: [
    ["t", "light or dark"],
    ["?", "these keys"],
  ],
};
