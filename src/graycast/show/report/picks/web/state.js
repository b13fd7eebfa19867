"use strict";
// The state of a replay and the user's choices, which the scripts of the page share.

{
  Object.assign(Graycast.prefs, {
    points: true,
    parts: false,
    robot: true,
    bin: true,
    pointPaint: "plain",
    pointSize: 2,
    limit: 1, // This limits the colours of differences, which do not occur here.
    speed: 1,
    goOn: true,
  });

  Graycast.replay = /** @type {any} */ ({ open: null, running: 0, waiting: 0 });
  Graycast.opened = () => Graycast.replay.open; // for use in the browser's console
}
