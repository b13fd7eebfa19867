"use strict";
// The scans of the attempts, which are loaded when they are needed, and the viewpoints.

{
  const { replay } = Graycast;
  const MOST = 8; // number of scans in memory
  const scans = new Map(); // key -> promise of an attempt's scan and motion

  /** Return a promise of an attempt's scan and motion; the oldest scan is forgotten. */
  replay.bringAttempt = (bin, number) => {
    const file = `${bin.key}/attempt-${String(number).padStart(3, "0")}.js`;
    if (!scans.has(file)) {
      const promise = Graycast.bring(file, file).then(unpack);
      promise.catch(() => scans.delete(file));
      scans.set(file, promise);
      while (scans.size > MOST) scans.delete(scans.keys().next().value);
    }
    return scans.get(file);
  };

  async function unpack(content) {
    const { width, height, motion } = content,
      n = width * height;
    const words = await Graycast.inflate(content.depth),
      limbs = await Graycast.inflate(motion.limbs);
    return {
      ...content,
      n,
      depth: null,
      view: Graycast.report.view,
      has: { depth: false, scanner: true },
      instances: [],
      scanner: Graycast.unpackWords(words, width, height),
      instance: new Uint16Array(n),
      rgb: await Graycast.pixels(content.picture, content),
      motion: { ...motion, limbs: new Float32Array(limbs.buffer) },
    };
  }

  /** Return the viewpoints; the robot is behind the bin. */
  replay.spaceOf = ({ middle, bin, yaw, reach }, scan) => {
    const about = (place, more) => ({
      ...more,
      pan: place.map((v, k) => v - middle[k]),
    });
    const views = {
      robot: about(middle, { yaw, pitch: 0.42, distance: 4.4 * reach }),
      bin: about(bin, { yaw, pitch: 0.75, distance: 2 * reach }),
      side: about(middle, { yaw, pitch: 0.08, distance: 4.4 * reach }),
      top: about(bin, { yaw, pitch: 1.55, distance: 3.2 * reach }),
    };
    const world = Graycast.shapes.pointOf(scan); // All scans are from the same viewpoint.
    return {
      middle,
      reach,
      views,
      start: views.robot,
      point: (i, step) => world(i, step).map((v, k) => v - middle[k]),
    };
  };
}
