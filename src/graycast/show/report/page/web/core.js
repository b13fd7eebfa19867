"use strict";
// Functions that the other scripts share: elements, formats of numbers, and the loading of scenes.

/** @type {Shared} */
const Graycast = /** @type {any} */ ({ report: null, prefs: {} });

// --- elements -----------------------------------------------------------------------------------

/** Make an element: el("div", {class: "x", onclick: f}, "text", child, ...). */
Graycast.el = (tag, attributes = {}, ...children) => {
  const svg = ["svg", "g", "rect", "path", "text", "line"].includes(tag);
  const made = svg
    ? document.createElementNS("http://www.w3.org/2000/svg", tag)
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return made;
};

/** Show a short text at the pointer; an empty text hides it. */
Graycast.tip = (event, text) => {
  const tip = document.getElementById("tip");
  tip.hidden = !text;
  if (!text) return;
  tip.textContent = text;
  const flip = event.clientX > innerWidth - tip.offsetWidth - 24;
  tip.style.left = `${flip ? event.clientX - tip.offsetWidth - 12 : event.clientX + 14}px`;
  tip.style.top = `${Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 8)}px`;
};

// --- light --------------------------------------------------------------------------------------

/** Convert a level of 8-bit sRGB to linear light from 0 to 1, and back (IEC 61966-2-1). */
Graycast.linear = (level) => {
  const s = level / 255;
  return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
};
Graycast.encoded = (share) => {
  const x = Math.min(Math.max(share, 0), 1);
  return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
};

// --- formats of numbers -------------------------------------------------------------------------

Graycast.words = (name) => name.replaceAll("_", " ");
Graycast.count = (value) => value.toLocaleString("en-US");
Graycast.percent = (share, digits = 1) =>
  share === null || share === undefined ? "–" : `${(100 * share).toFixed(digits)} %`;
Graycast.mm = (value, digits = 1) =>
  value === null || value === undefined || Number.isNaN(value)
    ? "–"
    : `${value.toFixed(digits)} mm`;
Graycast.signed = (value, digits = 2) =>
  `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;

/** Return the rows of the scenes as objects, in the dataset's order. */
Graycast.rows = () => {
  if (Graycast.allRows) return Graycast.allRows;
  const { columns, scenes } = Graycast.report;
  Graycast.allRows = scenes.map((values) => {
    const row = Object.fromEntries(columns.map((name, k) => [name, values[k]]));
    row.scene = `${row.split}-${String(row.id).padStart(6, "0")}`;
    row.key = row.picture ? `${row.scene}-${row.picture}` : row.scene;
    return row;
  });
  return Graycast.allRows;
};

/** Return shares by reason of the parts' visible pixels, or of all pixels if no part is visible. */
Graycast.ownReasons = (row) => row.part_reasons ?? row.reasons;

/** Return all pictures of a picture's scene, including itself. */
Graycast.siblings = (row) => Graycast.rows().filter((other) => other.scene === row.scene);

/** Return the rig and the code that took a scene's picture; null if they are unknown. */
Graycast.scannerOf = (scene) =>
  Graycast.report.scanners?.[scene.sensor ?? ""] ?? { rig: null, code: null };

Graycast.reasonColors = () => {
  const table = new Uint8ClampedArray(256 * 3);
  for (const { number, color } of Graycast.report.reasons)
    for (let k = 0; k < 3; k++)
      table[3 * number + k] = parseInt(color.slice(1 + 2 * k, 3 + 2 * k), 16);
  return table;
};

/** @type {Record<string, Uint8Array>} */
const colormaps = {};
Graycast.colormap = (name) => {
  const hex = Graycast.report.colormaps[name];
  colormaps[name] ??= Uint8Array.from({ length: 768 }, (_, k) =>
    parseInt(hex.substr(2 * k, 2), 16),
  );
  return colormaps[name];
};

/** Return the colour of a colour map at a position from 0 to 1, as three bytes. */
Graycast.heat = (name, share) => {
  const at = 3 * Math.max(0, Math.min(255, Math.round(255 * share)));
  return Graycast.colormap(name).subarray(at, at + 3);
};

/** Return the standard deviation [mm] at which the colours end. */
Graycast.sigmaLimit = (scene) => (scene.sigmaHigh ??= Graycast.highest(scene.sigma, 0.98) || 1);

/** Return a colour for an instance; consecutive numbers have very different hues. */
Graycast.instanceColor = (index) => {
  const hue = (index * 137.508) % 360;
  const light = 0.58 + 0.09 * ((index % 3) - 1);
  const part = (n) => {
    const k = (n + hue / 30) % 12;
    return Math.round(
      255 * (light - 0.62 * Math.min(light, 1 - light) * Math.max(-1, Math.min(k - 3, 9 - k, 1))),
    );
  };
  return [part(0), part(8), part(4)];
};

// --- scenes -------------------------------------------------------------------------------------

const KEPT_SCENES = 6;
const cache = new Map(); // key -> promise of a scene
const waiting = new Map(); // key -> function that receives the script's content

/** Each script of a scene calls this function with its content. */
Graycast.receive = (content) => waiting.get(content.key)?.(content);

/**
 * Load the content of a script; a page on the disk can read files only through script tags.
 * @param {string} file
 * @param {string} name
 * @returns {Promise<any>}
 */
function bring(file, name) {
  return new Promise((resolve, reject) => {
    const script = Graycast.el("script", { src: `scenes/${file}` });
    waiting.set(name, (content) => {
      script.remove();
      waiting.delete(name);
      resolve(content);
    });
    script.onerror = script.onload = () => {
      // After a successful call, this rejection has no effect.
      script.remove();
      waiting.delete(name);
      reject(new Error(`scenes/${file} is missing or of another scene: run graycast report again`));
    };
    document.head.append(script);
  });
}

/** Load a run's detections in a scene; null if the run did not include the scene. */
Graycast.bringFound = (key) => {
  const name = `${key}/detections.js`;
  return Graycast.report.detections?.scenes[key] ? bring(name, name) : Promise.resolve(null);
};

/** Load a scene, with its maps as arrays. */
Graycast.load = (key) => {
  if (cache.has(key)) {
    const held = cache.get(key);
    cache.delete(key);
    cache.set(key, held); // The most recently used scene is the last.
    return held;
  }
  const promise = bring(`${key}/scene.js`, key).then(unpackScene);
  cache.set(key, promise);
  promise.catch(() => cache.delete(key));
  while (cache.size > KEPT_SCENES) cache.delete(cache.keys().next().value);
  return promise;
};

async function unpackScene(content) {
  const n = content.width * content.height;
  const [depth, scanner, reason, instance] = await Promise.all(
    ["depth", "scanner", "reason", "instance"].map((name) => inflate(content.maps[name])),
  );
  const scene = { ...content, maps: null, pictures: null, n };
  scene.depth = words(depth, content.width, content.height);
  scene.reason = reason;
  scene.scanner = difference(scanner, scene.depth, reason);
  scene.instance = words(instance, content.width, content.height);
  for (const [name, url] of Object.entries(content.pictures))
    scene[name] = await pixels(url, content);
  return scene;
}

// --- further data of a scene, loaded on demand and released with the scene -----------------------

/**
 * Return the captured frame `k` as grey levels from 0 to 255, or null while it is loading. `ready`
 * is called when it has arrived. If loading has failed, the error is thrown.
 */
Graycast.frame = (scene, k, ready) => {
  const held = (scene.frames ??= { levels: new Map(), coming: new Set() });
  if (held.error) throw held.error;
  if (!held.coming.has(k)) {
    held.coming.add(k);
    const name = `${scene.key}/frames.js`;
    held.script ??= bring(name, name);
    held.script
      .then(async (content) => {
        held.content = content;
        const rgba = await pixels(content.pictures[k], scene);
        held.levels.set(
          k,
          Uint8Array.from({ length: scene.n }, (_, i) => rgba[4 * i]),
        );
      })
      .catch((error) => (held.error = error))
      .then(() => scene.frames === held && ready());
  }
  return held.levels.get(k) ?? null;
};

/** Return decoded positions {column, sigma_column, ...} [px], NaN where missing; null while loading. */
Graycast.columns = (scene, ready) => {
  const held = (scene.columns ??= {});
  if (held.error) throw held.error;
  const name = `${scene.key}/columns.js`;
  held.script ??= bring(name, name)
    .then(async (content) => {
      const maps = {};
      for (const [axis, map] of Object.entries(content.maps)) {
        const steps = words(await inflate(map.words), scene.width, scene.height);
        maps[axis] = Float32Array.from(steps, (v) => (v ? map.low + (v - 1) * map.step : NaN));
      }
      held.maps = maps;
    })
    .catch((error) => (held.error = error))
    .then(() => scene.columns === held && ready());
  return held.maps ?? null;
};

/** Return the fused cloud of all pictures of the scene; null while it is loading. */
Graycast.fused = (scene, ready) => {
  const held = (scene.fusing ??= {});
  if (held.error) throw held.error;
  const name = `${scene.fusedKey}/fused.js`;
  held.script ??= bring(name, name)
    .then((content) => {
      const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      const maps = ["color", "sigma", "views", "view", "first"].map((k) => [k, bytes(content[k])]);
      held.cloud = {
        ...content,
        ...Object.fromEntries(maps),
        place: new Uint16Array(bytes(content.place).buffer),
        normal: new Int8Array(bytes(content.normal).buffer),
      };
    })
    .catch((error) => (held.error = error))
    .then(() => scene.fusing === held && ready());
  return held.cloud ?? null;
};

Graycast.letGo = (scene) => {
  scene.frames = scene.columns = scene.shown = scene.fusing = null;
};

Object.assign(Graycast, { bring, inflate, pixels, unpackWords: words });

/**
 * @param {string} text
 * @returns {Promise<Uint8Array>}
 */
async function inflate(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * Undo packing.pack_words: add up the residuals of the prediction from three neighbours.
 * @param {Uint8Array} bytes
 * @param {number} width
 * @param {number} height
 */
function words(bytes, width, height) {
  const n = width * height,
    out = new Uint16Array(n);
  for (let r = 0, i = 0; r < height; r++) {
    let row = 0; // sum of this row's residuals: v[r, c] - v[r-1, c]
    for (let c = 0; c < width; c++, i++) {
      row += bytes[i] | (bytes[n + i] << 8);
      out[i] = row + (r ? out[i - width] : 0);
    }
  }
  return out;
}

/**
 * Undo packing.pack_difference.
 * @param {Uint8Array} bytes
 * @param {Uint16Array} base
 * @param {Uint8Array} reason
 */
function difference(bytes, base, reason) {
  const n = base.length,
    out = new Uint16Array(n);
  for (let i = 0; i < n; i++) {
    if (reason[i]) continue;
    const folded = bytes[i] | (bytes[n + i] << 8);
    out[i] = base[i] + (folded & 1 ? -(folded + 1) / 2 : folded / 2);
  }
  return out;
}

/**
 * Return the RGBA bytes of a picture in a data URL; scripts cannot read the pixels of a file.
 * @param {string} url
 * @param {{width: number, height: number}} size
 */
async function pixels(url, { width, height }) {
  const image = new Image();
  image.src = url;
  await image.decode();
  const canvas = Graycast.el("canvas", { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0, width, height);
  return context.getImageData(0, 0, width, height).data;
}
