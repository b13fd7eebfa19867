"use strict";
// One bin: the moving robot over the scans, attempt by attempt.

{
  const { el, outcomes } = Graycast;
  const prefs = Object.assign(Graycast.prefs, {
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
  const SPEEDS = [0.25, 0.5, 1, 2, 4, 8],
    STEP_S = 0.05,
    REST_MS = 450; // the pause between two attempts
  let open = null; // the bin that is shown
  let running = 0; // the id of the requested frame, 0 for none
  let waiting = 0; // the timer of the next attempt

  Graycast.showScene = async (main, key, isCurrent) => {
    const [name, text = ""] = key.split("/"),
      bin = Graycast.report.bins.find((one) => one.key === name);
    if (!bin) throw new Error(`there is no ${name} in this report`);
    const number = /^\d+$/.test(text) ? Number(text) : start(bin);
    if (number >= bin.attempts.length)
      throw new Error(`${name} has ${bin.attempts.length} attempts, and no number ${number + 1}`);
    const content =
      open?.bin === bin ? open.content : await Graycast.bring(`${name}/scene.js`, name);
    const scan = await bringAttempt(bin, number);
    if (!isCurrent()) return;
    if (open?.bin !== bin) await enter(main, bin, content, scan, number, isCurrent);
    if (!isCurrent() || !open) return;
    show(number, scan);
    const next = number + 1;
    if (next < bin.attempts.length) bringAttempt(bin, next).catch(() => {});
  };

  /** Return the first attempt with a selected outcome. */
  const start = (bin) => Math.max(bin.attempts.findIndex(outcomes.looked), 0);

  const KEPT = 8;
  const scans = new Map(); // key -> promise of an attempt's scan and motion
  function bringAttempt(bin, number) {
    const file = `${bin.key}/attempt-${String(number).padStart(3, "0")}.js`;
    if (!scans.has(file)) {
      const promise = Graycast.bring(file, file).then(unpack);
      promise.catch(() => scans.delete(file));
      scans.set(file, promise);
      while (scans.size > KEPT) scans.delete(scans.keys().next().value);
    }
    return scans.get(file);
  }

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

  // --- the page of a bin --------------------------------------------------------------------------

  async function enter(main, bin, content, scan, number, isCurrent) {
    const space = seenFrom(Graycast.report.look, scan),
      mine = { bin, content, number, scan, time: 0 };
    const bodies = await Graycast.makeBodies(space.middle, () => ({
      content,
      attempt: content.attempts[mine.number],
      number: mine.number,
      motion: mine.scan.motion,
      time: mine.time,
    }));
    if (!isCurrent()) return;
    Graycast.closeScene();
    open = mine;
    document.title = `${Graycast.report.name} ${bin.id} · graycast`;
    document.getElementById("where").textContent = `${Graycast.report.name} / bin ${bin.id}`;
    document.getElementById("steps").replaceChildren(...steps(bin));
    open.cloud = Graycast.makeCloud(scan, { space, bodies });
    main.replaceChildren(
      el(
        "section",
        { class: "scene replay" },
        el("div", { class: "toolbars" }, el("div", { class: "options" })),
        el(
          "div",
          { class: "left" },
          el("div", { class: "hold" }, open.cloud.stage),
          el("div", { class: "player" }),
          el("div", { class: "under" }),
        ),
        el(
          "aside",
          {},
          el("div", { id: "ended" }),
          el("img", { id: "attempt-picture", alt: "what the camera saw" }),
          el("table", { id: "attempt-facts" }),
          el("div", { class: "chips", id: "filter" }),
          el("div", { id: "attempts" }),
        ),
      ),
    );
    options();
    player();
  }

  /** Return the viewpoints; the robot is behind the bin. */
  function seenFrom({ middle, bin, yaw, reach }, scan) {
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
  }

  function steps(bin) {
    const { bins } = Graycast.report,
      at = bins.indexOf(bin);
    const link = (to, id, title, text) =>
      el("a", to ? { href: `#/${to.key}`, id, title } : { class: "off" }, text);
    return [
      link(bins[at - 1], "before", "bin before (↑)", "← bin before"),
      el("span", {}, `${at + 1} of ${bins.length}`),
      link(bins[at + 1], "after", "next bin (↓)", "next bin →"),
    ];
  }

  function options() {
    const toggle = (name, key, label, title) =>
      el(
        "button",
        {
          id: `toggle-${name}`,
          title,
          "aria-pressed": String(!!prefs[name]),
          onclick: () => set(name, !prefs[name]),
        },
        el("kbd", {}, key),
        label,
      );
    const choose = (name, list) =>
      el(
        "select",
        {
          id: `choose-${name}`,
          "aria-label": name,
          onchange: (event) => set(name, list.find(([v]) => String(v) === event.target.value)[0]),
        },
        list.map(([value, text]) => el("option", { value, selected: prefs[name] === value }, text)),
      );
    document.querySelector("#main .options").replaceChildren(
      toggle("points", "p", "scan", "the scan that the robot used"),
      choose("pointPaint", [
        ["plain", "plain"],
        ["depth", "by depth"],
        ["colour", "as in the picture"],
      ]),
      choose(
        "pointSize",
        [1, 2, 3, 4].map((v) => [v, `${v} px`]),
      ),
      toggle("parts", "m", "true parts", "the true poses of the parts"),
      toggle("robot", "r", "robot", "arm and tool"),
      toggle("bin", "b", "bin", "bin and table"),
      el("span", { class: "spring" }),
      ...["robot", "bin", "side", "top"].map((name) =>
        el(
          "button",
          {
            "data-look": name,
            title: `look at or from: ${name}`,
            onclick: () => open.cloud.look(name),
          },
          name,
        ),
      ),
    );
  }

  function set(name, value) {
    prefs[name] = value;
    options();
    open.cloud.draw(prefs);
  }

  // --- an attempt -----------------------------------------------------------------------------------

  function show(number, scan) {
    clearTimeout(waiting);
    const another = number !== open.number;
    open.number = number;
    if (open.scan !== scan) {
      open.scan = scan;
      open.cloud.swap(scan);
    }
    if (another) open.time = 0;
    const picture = /** @type {HTMLImageElement} */ (document.getElementById("attempt-picture"));
    picture.src = scan.picture;
    told();
    facts();
    attempts();
    player();
    seek(open.time);
    if (open.goesOn) play(true);
    open.goesOn = false;
  }

  const length = () => open.scan.motion.time_s.at(-1);

  function told() {
    const attempt = open.content.attempts[open.number],
      one = outcomes.named(attempt.outcome);
    document
      .getElementById("ended")
      .replaceChildren(
        el("h1", {}, outcomes.swatch(one), attempt.outcome),
        el("p", {}, `Attempt ${open.number + 1} of ${open.bin.attempts.length}: ${one.meaning}.`),
        attempt.detail ? el("p", { class: "soft" }, attempt.detail) : "",
      );
  }

  function facts() {
    const attempt = open.content.attempts[open.number],
      { parts } = Graycast.report,
      error = attempt.pose_error,
      thought = Object.entries(attempt.work_s);
    const lines = [
      ["parts in the bin", String(attempt.present.length)],
      ["detections", String(attempt.targets)],
      ["intended part", attempt.kind === null ? null : Graycast.words(parts[attempt.kind].name)],
      ["touched part", attempt.part === null ? null : String(attempt.part)],
      ["score of the grip", attempt.score?.toFixed(3)],
      [
        "pose off by",
        error
          ? `${((error.angle_rad * 180) / Math.PI).toFixed(2)}°, ${(1000 * error.distance_m).toFixed(2)} mm`
          : null,
      ],
      [
        "holds at least",
        attempt.least_factor === null ? null : `${attempt.least_factor.toFixed(2)} × the load`,
      ],
      [
        "scan, motion",
        `${attempt.seconds.scan.toFixed(2)} s, ${attempt.seconds.motion.toFixed(2)} s`,
      ],
      ["machine", thought.map(([stage, s]) => `${stage} ${s.toFixed(2)}`).join(", ") + " s"],
    ].filter(([, value]) => value !== null && value !== undefined);
    document
      .getElementById("attempt-facts")
      .replaceChildren(
        ...lines.map(([name, value]) => el("tr", {}, el("th", {}, name), el("td", {}, value))),
      );
  }

  function tally() {
    /** @type {Record<string, number>} */
    const counts = {};
    for (const { outcome } of open.content.attempts) counts[outcome] = (counts[outcome] ?? 0) + 1;
    return counts;
  }

  function attempts() {
    document.getElementById("filter").replaceChildren(...outcomes.buttons(tally(), attempts));
    document.getElementById("attempts").replaceChildren(
      ...open.content.attempts.flatMap((attempt, i) => {
        if (!outcomes.looked(outcomes.number(attempt.outcome)) && i !== open.number) return [];
        return el(
          "a",
          {
            href: `#/${open.bin.key}/${i}`,
            class: i === open.number ? "attempt now" : "attempt",
            "data-outcome": attempt.outcome,
          },
          outcomes.swatch(outcomes.named(attempt.outcome)),
          el("b", {}, String(i + 1)),
          el("span", {}, attempt.outcome),
          el("em", {}, `${attempt.seconds.motion.toFixed(1)} s`),
        );
      }),
    );
    document.querySelector("#attempts .now")?.scrollIntoView({ block: "nearest" });
  }

  // --- time -------------------------------------------------------------------------------------------

  function player() {
    document.querySelector("#main .player").replaceChildren(
      el(
        "button",
        { id: "play", "aria-pressed": String(!!running), onclick: () => play(!running) },
        el("kbd", {}, "space"),
        "play",
      ),
      el("input", {
        id: "time",
        type: "range",
        "aria-label": "time",
        min: 0,
        max: length(),
        step: 0.01,
        value: open.time,
        oninput: (event) => {
          play(false);
          seek(Number(event.target.value));
        },
      }),
      el("span", { id: "clock" }),
      el(
        "select",
        {
          id: "speed",
          "aria-label": "speed",
          onchange: (event) => faster(Number(event.target.value)),
        },
        SPEEDS.map((v) => el("option", { value: v, selected: v === prefs.speed }, `× ${v}`)),
      ),
      el(
        "label",
        {},
        el("input", {
          id: "go-on",
          type: "checkbox",
          checked: prefs.goOn,
          onchange: (event) => (prefs.goOn = event.target.checked),
        }),
        "all attempts",
      ),
    );
  }

  function faster(speed) {
    prefs.speed = speed;
    player();
    seek(open.time);
  }

  function seek(time) {
    open.time = Math.min(Math.max(time, 0), length());
    const slider = /** @type {HTMLInputElement} */ (document.getElementById("time"));
    slider.value = String(open.time);
    document.getElementById("clock").textContent =
      `${open.time.toFixed(2)} of ${length().toFixed(2)} s`;
    document.querySelector("#main .under").textContent = words();
    open.cloud.draw(prefs);
  }

  /** Describe the present motion in words. */
  function words() {
    const { motion } = open.scan,
      { outcome } = open.content.attempts[open.number];
    if (motion.grip === undefined) return "The arm does not move.";
    if (open.time < motion.time_s[motion.grip]) return "The tool moves to its grip.";
    const until = motion.held_until_s;
    if (until === null) return `The tool leaves without a part: ${outcome}.`;
    return open.time <= until ? "The tool carries the part." : `The part is released: ${outcome}.`;
  }

  function play(on) {
    cancelAnimationFrame(running);
    clearTimeout(waiting);
    running = 0;
    if (on && open.time >= length() - 1e-6) open.time = 0;
    let last = null;
    const step = (ms) => {
      if (!open) return;
      if (last !== null) seek(open.time + ((ms - last) / 1000) * prefs.speed);
      last = ms;
      if (open.time < length() - 1e-6) running = requestAnimationFrame(step);
      else ended();
    };
    if (on) running = requestAnimationFrame(step);
    document.getElementById("play")?.setAttribute("aria-pressed", String(!!running));
  }

  /** Continue with the next selected attempt if all attempts are to be played. */
  function ended() {
    running = 0;
    const next = neighbour(1);
    if (prefs.goOn && next !== null)
      waiting = setTimeout(() => {
        if (!open) return;
        open.goesOn = true;
        location.replace(`#/${open.bin.key}/${next}`);
      }, REST_MS / prefs.speed);
    else document.getElementById("play")?.setAttribute("aria-pressed", "false");
  }

  function neighbour(by) {
    const all = open.bin.attempts;
    for (let i = open.number + by; i >= 0 && i < all.length; i += by)
      if (outcomes.looked(all[i])) return i;
    return null;
  }

  Graycast.closeScene = () => {
    if (!open) return;
    play(false);
    open.cloud.close();
    open = null;
    document.getElementById("steps").replaceChildren();
    Graycast.tip(null, "");
  };

  Graycast.sceneKey = (event) => {
    if (!open) return false;
    const press = (id) => document.getElementById(id)?.click();
    const go = (by) => {
      const next = neighbour(by);
      if (next !== null) location.hash = `#/${open.bin.key}/${next}`;
    };
    const speed = (by) => SPEEDS[SPEEDS.indexOf(prefs.speed) + by] ?? prefs.speed;
    if (event.key === " ") play(!running);
    else if (event.key === "ArrowLeft") go(-1);
    else if (event.key === "ArrowRight") go(1);
    else if (event.key === "ArrowUp") press("before");
    else if (event.key === "ArrowDown") press("after");
    else if (event.key === "," || event.key === ".") {
      play(false);
      seek(open.time + (event.key === "." ? STEP_S : -STEP_S));
    } else if (event.key === "+" || event.key === "=") faster(speed(1));
    else if (event.key === "-") faster(speed(-1));
    else if (event.key === "p") press("toggle-points");
    else if (event.key === "m") press("toggle-parts");
    else if (event.key === "r") press("toggle-robot");
    else if (event.key === "b") press("toggle-bin");
    else return false;
    return true;
  };
  Graycast.redraw = () => open?.cloud.draw(prefs);
  Graycast.opened = () => open; // for use in the browser's console
}
