"use strict";
// The time of an attempt: playing it, moving through it, and going on to the next one.

{
  const { el, outcomes, prefs, replay } = Graycast;
  const SPEEDS = [0.25, 0.5, 1, 2, 4, 8],
    STEP_S = 0.05,
    REST_MS = 450; // the pause between two attempts

  const length = () => replay.open.scan.motion.time_s.at(-1);

  /** Show the controls of the time. */
  replay.showPlayer = () => {
    document.querySelector("#main .player").replaceChildren(
      el(
        "button",
        {
          id: "play",
          "aria-pressed": String(!!replay.running),
          onclick: () => replay.play(!replay.running),
        },
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
        value: replay.open.time,
        oninput: (event) => {
          replay.play(false);
          replay.seek(Number(event.target.value));
        },
      }),
      el("span", { id: "clock" }),
      el(
        "select",
        {
          id: "speed",
          "aria-label": "speed",
          onchange: (event) => setSpeed(Number(event.target.value)),
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
  };

  function setSpeed(speed) {
    prefs.speed = speed;
    replay.showPlayer();
    replay.seek(replay.open.time);
  }

  /** Take the next faster (1) or slower (-1) speed, if there is one. */
  replay.changeSpeed = (by) => setSpeed(SPEEDS[SPEEDS.indexOf(prefs.speed) + by] ?? prefs.speed);

  /** Show a time of the attempt [s]. */
  replay.seek = (time) => {
    replay.open.time = Math.min(Math.max(time, 0), length());
    const slider = /** @type {HTMLInputElement} */ (document.getElementById("time"));
    slider.value = String(replay.open.time);
    document.getElementById("clock").textContent =
      `${replay.open.time.toFixed(2)} of ${length().toFixed(2)} s`;
    document.querySelector("#main .under").textContent = describe();
    replay.open.cloud.draw(prefs);
  };

  /** Stop, and move by a number of time steps. */
  replay.step = (by) => {
    replay.play(false);
    replay.seek(replay.open.time + by * STEP_S);
  };

  /** Describe the present motion in words. */
  function describe() {
    const { open } = replay,
      { motion } = open.scan,
      { outcome } = open.content.attempts[open.number];
    if (motion.grip === undefined) return "The arm does not move.";
    if (open.time < motion.time_s[motion.grip]) return "The tool moves to its grip.";
    const until = motion.held_until_s;
    if (until === null) return `The tool leaves without a part: ${outcome}.`;
    return open.time <= until ? "The tool carries the part." : `The part is released: ${outcome}.`;
  }

  /** Start or stop the motion; after the end, it starts again. */
  replay.play = (on) => {
    cancelAnimationFrame(replay.running);
    clearTimeout(replay.waiting);
    replay.running = 0;
    if (on && replay.open.time >= length() - 1e-6) replay.open.time = 0;
    let last = null;
    const step = (ms) => {
      if (!replay.open) return;
      if (last !== null) replay.seek(replay.open.time + ((ms - last) / 1000) * prefs.speed);
      last = ms;
      if (replay.open.time < length() - 1e-6) replay.running = requestAnimationFrame(step);
      else continueAfterEnd();
    };
    if (on) replay.running = requestAnimationFrame(step);
    document.getElementById("play")?.setAttribute("aria-pressed", String(!!replay.running));
  };

  /** Continue with the next selected attempt if all attempts are to be played. */
  function continueAfterEnd() {
    replay.running = 0;
    const next = replay.neighbour(1);
    if (prefs.goOn && next !== null)
      replay.waiting = setTimeout(() => {
        if (!replay.open) return;
        replay.open.goesOn = true;
        location.replace(`#/${replay.open.bin.key}/${next}`);
      }, REST_MS / prefs.speed);
    else document.getElementById("play")?.setAttribute("aria-pressed", "false");
  }

  /** Return the number of the next or previous selected attempt; null if there is none. */
  replay.neighbour = (by) => {
    const all = replay.open.bin.attempts;
    for (let i = replay.open.number + by; i >= 0 && i < all.length; i += by)
      if (outcomes.looked(all[i])) return i;
    return null;
  };
}
