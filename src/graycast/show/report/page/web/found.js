"use strict";
// A detector's results: counts for the grid, outlines over a scene, and a list next to it.

{
  const { el, prefs } = Graycast;
  /** @type {Found} */
  const found = /** @type {any} */ ({});
  Graycast.found = found;
  const COLOR = { hit: "#35d07f", mistake: "#ff4b4b", missed: "#ffb01f", ignored: "#b9c0c8" };
  const LABEL = { hit: "hit", mistake: "false", missed: "missed", ignored: "ignored" };
  const SHOWN = {
    all: ["hit", "mistake", "missed", "ignored"],
    hit: ["hit"],
    mistake: ["mistake"],
    missed: ["missed"],
    wrong: ["mistake", "missed"],
  };
  found.KINDS = [
    ["all", "all"],
    ["hit", "hits"],
    ["mistake", "false alone"],
    ["missed", "missed alone"],
    ["wrong", "false and missed"],
  ];
  found.FILTERS = [
    ["", "found or not"],
    ["missed", "with missed"],
    ["mistake", "with false"],
    ["wrong", "with either"],
    ["right", "all right"],
    ["unseen", "detector not run"],
  ];
  found.SORTS = Graycast.report?.detections
    ? [
        ["missed", "missed"],
        ["mistakes", "false detections"],
      ]
    : [];
  found.words = (filter) => found.FILTERS.find(([value]) => value === filter)[1];

  // --- the grid -----------------------------------------------------------------------------------

  /** Show the quality of the detections above the grid, or nothing without detections. */
  found.told = () => {
    const lines = Graycast.report.detections?.told ?? [];
    return lines.length
      ? el(
          "section",
          { id: "found-told" },
          lines.map((line) => el("p", {}, line)),
        )
      : null;
  };

  /** Count a row's missed instances or false detections; null if the run left out the scene. */
  found.count = (row, what) => {
    const held = Graycast.report.detections?.scenes[row.key];
    if (!held) return null;
    const from = (scores) => scores.filter((score) => score >= prefs.score).length;
    return what === "missed" ? held.wanted - from(held.hits) : from(held.mistakes);
  };

  found.fits = (row, filter) => {
    if (!filter) return true;
    const missed = found.count(row, "missed"),
      mistakes = found.count(row, "mistakes");
    if (missed === null) return filter === "unseen";
    return {
      missed: missed > 0,
      mistake: mistakes > 0,
      wrong: missed + mistakes > 0,
      right: missed + mistakes === 0,
      unseen: false,
    }[filter];
  };

  /** When a scene is opened from the grid, show only the detections that the filter selected. */
  found.follow = (filter) => {
    prefs.found = true;
    prefs.foundKind = filter in SHOWN ? filter : "all";
  };

  /** Return the detections' line on a card. */
  found.line = (row) => {
    const held = Graycast.report.detections?.scenes[row.key];
    if (!Graycast.report.detections) return null;
    if (!held) return el("div", { class: "found-line" }, "detector not run");
    const missed = found.count(row, "missed"),
      mistakes = found.count(row, "mistakes");
    return el(
      "div",
      { class: "found-line" },
      `${held.wanted - missed} of ${held.wanted} found`,
      missed
        ? [", ", el("b", { style: `border-color:${COLOR.missed}` }, `${missed} missed`)]
        : null,
      mistakes
        ? [", ", el("b", { style: `border-color:${COLOR.mistake}` }, `${mistakes} false`)]
        : null,
    );
  };

  /** Return a slider for the score threshold, with its value. */
  found.slider = (id, held, change) => {
    const say = el("span", { class: "score" }, held.score.toFixed(2));
    return el(
      "label",
      { title: "Detections with a lower score are ignored." },
      "score from",
      el("input", {
        id,
        type: "range",
        min: 0,
        max: 1,
        step: 0.01,
        value: held.score,
        "aria-label": "score from",
        oninput: (event) => {
          say.textContent = event.target.valueAsNumber.toFixed(2);
          change(event.target.valueAsNumber);
        },
      }),
      say,
    );
  };

  // --- a scene ------------------------------------------------------------------------------------

  /** Return counted detections and missed instances: {state, text, box, rings, ...}. */
  function marks(scene, least) {
    if (!scene.found) return [];
    const seen = scene.found.detections
      .filter((one) => one.score >= least)
      .map((one) => ({ ...one, text: one.score.toFixed(2) }));
    const missed = Object.entries(scene.found.instances)
      .filter(([, one]) => !one.ignored && (one.found === null || one.found < least))
      .map(([k]) => {
        const { box, name, visible } = scene.instances[k];
        const [x, y, w, h] = box; // BOP's boxes end at pixel centres.
        return {
          name,
          state: "missed",
          instance: Number(k),
          visible,
          text: "",
          box: [x, y, w + 1, h + 1],
        };
      });
    return [...seen, ...missed];
  }

  /** Draw outlines over the picture: masks if there are any, else boxes. */
  found.draw = (scene, svg, prefs, lit) => {
    const drawn = [];
    if (prefs.found)
      marks(scene, prefs.score).forEach((one, k) => {
        if (!SHOWN[prefs.foundKind].includes(one.state)) return;
        drawn.push(...outline(one, scene.stride, lit.mark === k));
      });
    svg.replaceChildren(...drawn);
  };

  function outline(one, stride, strong) {
    const [x, y, w, h] = one.box.map((edge) => edge / stride),
      style = { stroke: COLOR[one.state], class: one.state + (strong ? " strong" : "") };
    const ring = (flat) =>
      flat
        .map((v, k) => (k % 2 ? "," : k ? "L" : "M") + (v + 0.5) / stride)
        .join("")
        .concat("Z");
    const shape = one.rings
      ? el("path", { ...style, d: one.rings.map(ring).join("") })
      : el("rect", { ...style, x, y, width: w, height: h });
    const text = one.text
      ? el("text", { x: x + w / 2, y: y + h / 2, fill: COLOR[one.state] }, one.text)
      : null;
    return [shape, text].filter(Boolean);
  }

  /** Return the list next to the picture; actions.light highlights an entry. */
  found.list = (scene, prefs, { light }) => {
    if (!scene.found)
      return Graycast.report.detections
        ? [el("p", {}, "The detector was not run on this scene.")]
        : [];
    const all = marks(scene, prefs.score),
      count = (state) => all.filter((one) => one.state === state).length;
    const order = ["mistake", "missed", "ignored", "hit"];
    const rows = all
      .map((one, k) => ({ one, k }))
      .sort((a, b) => order.indexOf(a.one.state) - order.indexOf(b.one.state));
    return [
      el(
        "div",
        { id: "found-counts" },
        ["hit", "mistake", "missed", "ignored"].map((state) =>
          el(
            "span",
            {},
            el("i", { style: `background:${COLOR[state]}` }),
            `${count(state)} ${LABEL[state]}`,
          ),
        ),
      ),
      el(
        "table",
        { id: "found-table" },
        el(
          "tbody",
          {},
          rows.map(({ one, k }) =>
            el(
              "tr",
              {
                "data-state": one.state,
                onpointerenter: () => light({ mark: k }),
                onpointerleave: () => light({ mark: -1 }),
              },
              el("td", {}, el("i", { style: `background:${COLOR[one.state]}` }), one.text),
              el("td", {}, one.name),
              el("td", {}, said(one)),
            ),
          ),
        ),
      ),
    ];
  };

  function said(one) {
    if (one.state === "mistake") return one.why ?? "";
    if (one.state === "missed")
      return `${one.instance} missed, ${Graycast.percent(one.visible, 0)} visible`;
    if (one.state === "ignored") return "an ignored instance";
    return `finds ${one.instance}`;
  }
}
