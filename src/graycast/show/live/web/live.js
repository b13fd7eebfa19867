"use strict";
// The page: the settings, their pictures as they arrive, and two pictures next to each other.

{
  const { el, percent, words } = Graycast;
  /** @type {(id: string) => any} */
  const at = (id) => document.getElementById(id);
  const main = at("main"),
    panel = at("controls");
  const prefs = Object.assign(Graycast.prefs, {
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
  Graycast.VIEWS.splice(-1, 1, { id: "sigma", label: "σ of depth" }); // 3D has its own place.
  Graycast.VIEWS.push({ id: "p_wrong", label: "doubt of depth" });
  const live = { latencies: [], errors: [], painted: 0 };
  Graycast.live = live;
  let version = 0,
    state = null,
    header = null,
    scene = null, // The viewer refers to this object, so it is kept while the size is the same.
    held = null,
    heldNumber = 0,
    viewer = null,
    world = null,
    bodies = null,
    pointed = -1;
  Graycast.opened = () => ({ scene, held, header, state, world });

  // --- commands to the server ---------------------------------------------------------------------

  const waiting = []; // commands that have not been sent
  let sending = false;

  /** Send a command after the waiting commands; of waiting drafts for a key, send only the last. */
  function send(command) {
    const last = waiting.at(-1);
    if (command.draft && last?.draft && last.key === command.key) waiting.pop();
    waiting.push({ ...command, since: performance.now() });
    if (!sending) pass();
  }
  async function pass() {
    sending = true;
    while (waiting.length) {
      const { since, ...command } = waiting.shift();
      if (command.do !== "look") tell(""); // An error may arrive before the answer.
      try {
        const reply = await fetch("do", {
          method: "POST",
          headers: { "Content-Type": "application/json" },
          body: JSON.stringify(command),
        });
        const answer = await reply.json();
        if (answer.number)
          live.latencies.push({ number: answer.number, since, ms: null, change: null });
        if (answer.error) {
          tell(answer.error);
          refresh(); // This resets the control to the present value.
        } else if (command.do === "rewrite" && at("text").value === command.text) {
          edited = false;
          refresh();
        }
        if (answer.saved) at("doing").textContent = `saved: ${answer.saved}`;
      } catch {
        tell("graycast live has ended: start it again and reload this page");
      }
    }
    sending = false;
  }
  const set = (key, value, draft) => send({ do: "set", key, value, draft });
  const drag = (changes, draft) => {
    const keys = Object.keys(changes);
    keys.forEach((key, k) => set(key, changes[key], draft || k < keys.length - 1));
  };

  function tell(text) {
    if (text) live.errors.push(text);
    at("error").hidden = !text;
    at("error").textContent = text;
  }

  // --- messages from the server -------------------------------------------------------------------

  const stream = new EventSource("events");
  stream.onmessage = ({ data }) => hear(JSON.parse(data));
  stream.onerror = () => {
    main.dataset.ready = "";
    version = 0; // A restarted server counts versions from 0.
  };

  function hear(message) {
    switch (message.kind) {
      case "state":
        state = message;
        main.dataset.asked = state.number;
        refresh();
        break;
      case "stage":
        at("doing").textContent = `${message.stage} …`;
        wait(`Starting: ${message.stage} …`);
        break;
      case "error":
        if (message.number && message.number !== state?.number) break; // It concerns earlier settings.
        at("doing").textContent = "";
        main.dataset.failed = message.number ?? "";
        main.classList.add("stale"); // The picture has other settings.
        tell(message.error);
        wait("There is no picture of these settings: the message above says why.");
        break;
      default:
        fetchNewer();
    }
  }

  /** Show a text at the place of the first picture. */
  function wait(text) {
    const place = at("waiting");
    if (place) place.textContent = text;
  }

  let fetching = null;
  let again = false;
  /** Fetch newer answers, with one request at a time. */
  function fetchNewer() {
    if (fetching) {
      again = true;
      return;
    }
    fetching = bring().finally(() => {
      fetching = null;
      if (again) {
        again = false;
        fetchNewer();
      }
    });
  }
  async function bring() {
    const reply = await fetch(`newer?${version}`);
    if (!reply.ok) return;
    const buffer = await reply.arrayBuffer();
    const length = new DataView(buffer).getUint32(0, true);
    const pieces = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    for (const piece of pieces) {
      version = Math.max(version, piece.version);
      const array = (name, Type) => {
        const [from, bytes] = piece.arrays[name];
        return new Type(buffer, 4 + length + from, bytes / Type.BYTES_PER_ELEMENT);
      };
      if (piece.kind === "world") takeWorld(piece, array);
    }
    for (const piece of pieces) {
      const array = (name, Type) => {
        const [from, bytes] = piece.arrays[name];
        return new Type(buffer, 4 + length + from, bytes / Type.BYTES_PER_ELEMENT);
      };
      if (piece.kind === "picture") takePicture(piece, array);
    }
  }

  function takeWorld({ header: said }, array) {
    const each = (end, Type) =>
      Object.fromEntries(said.meshes.map((name) => [name, array(`${name}.${end}`, Type)]));
    bodies = {
      ...said,
      vertices: each("vertices", Float32Array),
      faces: each("faces", Uint32Array),
      places: array("places", Float32Array),
    };
    world?.bodies(bodies);
    if (scene) world?.draw(prefs);
  }

  function opaque(bytes, channels) {
    const n = bytes.length / channels,
      out = new Uint8ClampedArray(4 * n);
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < 3; k++) out[4 * i + k] = bytes[channels * i + (channels === 3 ? k : 0)];
      out[4 * i + 3] = 255;
    }
    return out;
  }

  function takePicture({ header: said, arrays }, array) {
    const before = header;
    header = { ...said, values: { ...said.values, ...state.values } };
    prefs.axis = prefs.axis.startsWith("sigma_") ? `sigma_${said.axis}` : said.axis;
    prefs.frame = said.frame;
    Graycast.report.scanners[""] = { rig: said.rig, code: null };
    Graycast.report.statistics.part_error.sigma_mm = said.figures.sigma_mm;
    const frame = array("frame", Uint8Array);
    const next = {
      width: said.width,
      height: said.height,
      full: [said.width, said.height],
      n: said.width * said.height,
      stride: 1,
      depth_scale_mm: said.depth_scale_mm,
      view: said.view,
      has: { depth: true, scanner: true },
      kept: { frames: said.frames, columns: [said.axis, `sigma_${said.axis}`] },
      instances: [],
      depth: array("depth", Uint16Array),
      scanner: array("scanner", Uint16Array),
      sigma: array("sigma", Float32Array),
      p_wrong: arrays.p_wrong ? array("p_wrong", Float32Array) : null,
      reason: array("reason", Uint8Array),
      instance: array("instance", Uint16Array),
      white: opaque(array("white", Uint8Array), 1),
      levels: frame,
      positions: {
        [said.axis]: array("place", Float32Array),
        [`sigma_${said.axis}`]: array("place_sigma", Float32Array),
      },
      frames: { content: said },
      rays: null,
      range: null,
      projected: null,
      sigmaHigh: null,
    };
    if (arrays.rgb) next.rgb = opaque(array("rgb", Uint8Array), 3);
    const resized = !scene || scene.width !== next.width || scene.height !== next.height;
    if (resized) {
      next.rgb ??= opaque(new Uint8Array(3 * next.n), 3);
      scene = next;
      held = null;
    } else Object.assign(scene, next);
    if (held) held.range = Graycast.depthRange(scene);
    if (!world) {
      world = Graycast.makeWorld(scene, drag);
      at("hold-3d").replaceChildren(world.stage);
      if (bodies) world.bodies(bodies);
      world.draw(prefs);
      worldOptions();
    }
    if (resized) remakeViewer();
    world.show(header);
    if (before?.number !== said.number || said.exact) at("doing").textContent = "";
    show();
    count(said);
  }

  /** Record the time from the user's action to the first picture. */
  function count({ number, kind, first }) {
    live.painted += 1;
    for (const one of live.latencies)
      if (one.number === number && one.ms === null && first) {
        one.ms = performance.now() - one.since;
        one.change = kind;
      }
    live.latencies = live.latencies.filter((one) => one.number >= number || one.ms !== null);
    main.dataset.shown = number;
    if (number > Number(main.dataset.failed || -1)) main.classList.remove("stale");
    main.dataset.exact = String(header.exact);
    main.dataset.ready = "live";
  }

  Graycast.frame = (of, k) => {
    if (k !== of.frames.content.frame) return null;
    return of.levels;
  };
  Graycast.columns = (of) => of.positions;
  Graycast.repaint = () => show();

  // --- the page -----------------------------------------------------------------------------------

  function remakeViewer() {
    viewer?.close();
    viewer = Graycast.makeViewer(scene, point, held ?? scene);
    at("hold-2d").replaceChildren(viewer.stage);
  }

  function point(i) {
    pointed = i;
    readout();
  }

  const paint = Graycast.paint;
  Graycast.paint = (of, view, now, out) => {
    if (view === "p_wrong") return paintDoubt(of, out);
    if (view !== "sigma") return paint(of, view, now, out);
    const high = Graycast.sigmaLimit(of);
    for (let i = 0; i < of.n; i++) {
      const [r, g, b] =
        of.sigma[i] === of.sigma[i] ? Graycast.heat("magma", of.sigma[i] / high) : [58, 60, 66];
      out.set([r, g, b, 255], 4 * i);
    }
    return {
      bar: { map: "magma", low: 0, high, unit: "mm", digits: 2 },
      note: "standard deviation of the depth, as estimated by the scanner",
    };
  };

  /** Paint the logarithm of the probability that each depth is wrong. */
  function paintDoubt(of, out) {
    for (let i = 0; i < of.n; i++) {
      const p = of.p_wrong ? of.p_wrong[i] : NaN;
      const share = 1 + Math.log10(Math.max(p, 1e-4)) / 4;
      out.set([...(p === p ? Graycast.heat("magma", share) : [58, 60, 66]), 255], 4 * i);
    }
    return {
      bar: { map: "magma", low: -4, high: 0, unit: "log10", digits: 0 },
      note: of.p_wrong
        ? "probability that the depth is wrong, as estimated by the scanner"
        : "the scanner estimates this only with max_p_wrong below 1",
    };
  }

  function views() {
    const known = Graycast.VIEWS.filter((view) => view.id !== "p_wrong" || scene?.p_wrong);
    const buttons = known.map((view) =>
      el(
        "button",
        {
          "data-view": view.id,
          "aria-pressed": String(view.id === prefs.view),
          onclick: () => {
            prefs.view = view.id;
            show();
          },
        },
        view.label,
      ),
    );
    const frames = header.frames.map((name, k) =>
      el("option", { value: k, selected: k === prefs.frame }, words(name)),
    );
    at("views").replaceChildren(
      ...buttons,
      el(
        "select",
        {
          id: "choose-frame",
          hidden: prefs.view !== "pattern",
          onchange: (event) => send({ do: "look", frame: Number(event.target.value) }),
        },
        frames,
      ),
      el(
        "select",
        {
          id: "choose-column",
          hidden: prefs.view !== "column",
          onchange: (event) => {
            prefs.axis = event.target.value;
            show();
          },
        },
        [header.axis, `sigma_${header.axis}`].map((axis) =>
          el(
            "option",
            { value: axis, selected: axis === prefs.axis },
            axis.replace("sigma_", "σ of "),
          ),
        ),
      ),
      el(
        "select",
        {
          id: "choose-gain",
          "aria-label": "brightness",
          hidden: !["white", "pattern"].includes(prefs.view),
          onchange: (event) => {
            prefs.gain = Number(event.target.value);
            show();
          },
        },
        Graycast.GAINS.map((gain) =>
          el("option", { value: gain, selected: gain === prefs.gain }, `brightness × ${gain}`),
        ),
      ),
      el("span", { class: "spring" }),
      el(
        "select",
        {
          id: "choose-how",
          hidden: !held,
          onchange: (event) => {
            prefs.how = event.target.value;
            show();
          },
        },
        [
          ["side", "side by side"],
          ["swipe", "swipe"],
        ].map(([how, label]) => el("option", { value: how, selected: how === prefs.how }, label)),
      ),
    );
  }

  function bar({ map, low, high, unit, digits }) {
    const canvas = el("canvas", { width: 256, height: 1 }),
      context = canvas.getContext("2d"),
      image = context.createImageData(256, 1),
      table = Graycast.colormap(map);
    for (let k = 0; k < 256; k++) image.data.set([...table.subarray(3 * k, 3 * k + 3), 255], 4 * k);
    context.putImageData(image, 0, 0);
    return el(
      "span",
      { class: "bar" },
      low.toFixed(digits),
      canvas,
      `${high.toFixed(digits)} ${unit}`,
    );
  }

  function show() {
    if (!scene || !viewer) return;
    views();
    const said = viewer.paint(held ? [prefs.view, prefs.view] : [prefs.view], prefs);
    if (held)
      viewer.stage.querySelectorAll(".pane-name").forEach((name, k) => {
        name.textContent = k ? "held" : "now";
      });
    at("under").replaceChildren(
      el("div", {}, said[0].bar ? bar(said[0].bar) : null, said[0].note ?? ""),
    );
    readout();
    refresh();
    facts();
  }

  function readout() {
    const i = pointed,
      on = i >= 0,
      s = scene.depth_scale_mm;
    const mm = (value, digits = 2) => (on && value ? `${value.toFixed(digits)} mm` : "–");
    const twice = (of) => {
      const depth = of.depth[i] * s,
        scan = of.scanner[i] * s,
        reason = Graycast.report.reasons.find((r) => r.number === of.reason[i]),
        place = of.positions[header.axis]?.[i],
        spread = of.positions[`sigma_${header.axis}`]?.[i],
        { low_dn, high_dn } = of.frames.content;
      const dn = (level) =>
        on ? `≈ ${Math.round(low_dn + (high_dn - low_dn) * Graycast.linear(level))} DN` : "–";
      return {
        perfect: mm(depth),
        scanner: mm(scan),
        difference: on && depth && scan ? `${Graycast.signed(scan - depth)} mm` : "–",
        σ: on && scan ? `${of.sigma[i].toFixed(3)} mm` : "–",
        reason: on && reason ? words(reason.name) : "–",
        [header.axis]:
          on && place === place ? `${place.toFixed(2)} ± ${spread.toFixed(2)} px` : "–",
        "white frame": dn(of.white[4 * i]),
        "this frame": dn(of.levels[i]),
        part:
          on && of.instance[i]
            ? (bodies?.names[of.instance[i] - 1] ?? String(of.instance[i] - 1))
            : "–",
      };
    };
    const columns = held ? [twice(scene), twice(held)] : [twice(scene)];
    const head = el(
      "tr",
      {},
      el("th", {}, on ? `pixel ${i % scene.width}, ${Math.floor(i / scene.width)}` : "pixel"),
      (held ? ["now", "held"] : [""]).map((name) => el("td", {}, name)),
    );
    at("readout").replaceChildren(
      head,
      ...Object.keys(columns[0]).map((name) =>
        el(
          "tr",
          { "data-name": name },
          el("th", {}, name),
          columns.map((one) => el("td", {}, one[name])),
        ),
      ),
    );
  }

  function facts() {
    const { figures } = header,
      before = held?.frames.content.figures;
    const pair = (name, tell) =>
      before ? `${tell(figures[name])}  |  ${tell(before[name])}` : tell(figures[name]);
    const mm = (value) => (value === null ? "–" : `${value.toFixed(3)} mm`);
    const rows = [
      ["picture", `${header.samples} of ${header.of} samples${header.exact ? ", finished" : ""}`],
      ["decoded on parts", pair("part_decoded", (v) => percent(v))],
      ["median off, on parts", pair("bias_mm", mm)],
      ["σ on parts", pair("sigma_mm", mm)],
      ["exposure", pair("exposure_ms", (v) => `${v.toPrecision(3)} ms`)],
      ["white saturated", pair("saturated", (v) => percent(v))],
      [
        "baseline",
        `${header.rig.baseline_mm.toFixed(0)} mm, axes at ${header.rig.axes_deg.toFixed(1)}°`,
      ],
    ];
    at("figures").replaceChildren(
      ...rows
        .map(([name, value]) => [el("dt", {}, name), el("dd", { "data-name": name }, value)])
        .flat(),
    );
    const own = Graycast.ownReasons(figures),
      earlier = before && Graycast.ownReasons(before);
    at("reasons").replaceChildren(
      el("p", {}, figures.part_reasons ? "of the parts' pixels" : "of all pixels"),
      ...Graycast.report.reasons
        .filter((r) => figures.reasons[r.name] || before?.reasons[r.name])
        .map((r) =>
          el(
            "div",
            { title: r.meaning },
            el("i", { style: `background:${r.color}` }),
            el("span", {}, words(r.name)),
            el(
              "em",
              {},
              percent(own[r.name] ?? 0),
              earlier ? ` | ${percent(earlier[r.name] ?? 0)}` : "",
            ),
          ),
        ),
    );
  }

  /** Show the present settings. */
  function refresh() {
    if (!state) return;
    at("where").textContent = state.path;
    at("undo").disabled = !state.undo;
    at("redo").disabled = !state.redo;
    const name = at("save-name");
    if (!name.value)
      name.value = `${state.path
        .split("/")
        .at(-1)
        .replace(/\.ya?ml$/, "")}_live.yaml`;
    const values = { ...header?.values, ...state.values };
    Graycast.showControls(panel, { controls: state.controls, values }, state.said, set);
    allWords();
  }

  let edited = false; // whether the text differs from the settings in use
  function edit(on) {
    edited = on;
    at("reset").hidden = !on;
    if (!on && at("text").value !== state.text) at("text").value = state.text;
  }

  /** Show the configuration's text, where every key can be set; a refused text stays for editing. */
  function allWords() {
    let words = at("all-words");
    if (!words) {
      const text = el("textarea", {
        id: "text",
        spellcheck: "false",
        rows: 14,
        "aria-label": "the configuration",
        oninput: () => edit(true),
      });
      words = el(
        "details",
        { id: "all-words", "data-group": "text" },
        el("summary", {}, "All keys, as YAML"),
        text,
        el(
          "button",
          { id: "apply", onclick: () => send({ do: "rewrite", text: text.value }) },
          "apply",
        ),
        el(
          "button",
          {
            id: "reset",
            title: "replace the text by the settings in use",
            hidden: true,
            onclick: () => edit(false),
          },
          "discard the edits",
        ),
      );
      panel.append(words);
    }
    if (!edited) edit(false);
  }

  function worldOptions() {
    at("space-options").replaceChildren(
      ...Graycast.worldOptions(
        prefs,
        (name, value) => {
          prefs[name] = value;
          world.draw(prefs);
          worldOptions();
        },
        (name) => world.look(name),
      ),
    );
  }

  // --- buttons and keys ---------------------------------------------------------------------------

  at("undo").onclick = () => send({ do: "undo" });
  at("redo").onclick = () => send({ do: "redo" });
  at("save").onclick = () => send({ do: "save", name: at("save-name").value });
  at("hold").onclick = () => {
    if (!scene) return;
    held = held ? null : { ...scene };
    heldNumber = header.number;
    at("hold").setAttribute("aria-pressed", String(!!held));
    at("back").hidden = !held;
    remakeViewer();
    show();
  };
  at("back").onclick = () => send({ do: "return", number: heldNumber });
  addEventListener("keydown", (event) => {
    if (
      !(event.ctrlKey || event.metaKey) ||
      /** @type {HTMLElement} */ (event.target).matches("textarea, input:not([type=range])")
    )
      return;
    if (event.key.toLowerCase() !== "z") return;
    event.preventDefault();
    send({ do: event.shiftKey ? "redo" : "undo" });
  });
  const root = document.documentElement;
  root.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  at("theme").onclick = () => {
    root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
    world?.draw(prefs);
  };
}
