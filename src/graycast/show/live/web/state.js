"use strict";
// The state of the live page and the user's choices, which the scripts of the page share.

{
  Object.assign(Graycast.prefs, {
    view: "scanner",
    how: "side",
    frame: 2,
    source: "stored",
    axis: "column",
    limit: 0,
    gain: 1,
    points: true,
    parts: true,
    bin: true,
    camera: true,
    projector: true,
    common: true,
    pointPaint: "difference",
    pointSize: 1.5,
  });

  Graycast.live = /** @type {any} */ ({
    state: null,
    header: null,
    scene: null,
    held: null,
    world: null,
    bodies: null,
    edited: false,
    latencies: [],
    errors: [],
    painted: 0,
    at: (id) => document.getElementById(id),
  });
  Graycast.opened = () => Graycast.live;
}
