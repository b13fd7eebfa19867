"use strict";
// The grid of scenes: filtered, sorted, and only what is in view is in the page.

{
  const { el, percent } = Graycast;
  const GAP = 10,
    CARD_PX = 208,
    BELOW_PX = 46;
  const SORTS = [
    ["id", "number"],
    ["decoded", "decoded, all pixels"],
    ["part_decoded", "decoded, on parts"],
    ["visibility", "mean visibility"],
    ["instances", "instances"],
    ["depth_mm", "median depth"],
    ["sigma_mm", "scanner noise on parts"],
    ["bias_mm", "scanner bias on parts"],
    ["brightness", "white frame's brightness"],
  ];
  const blank = () => ({
    split: "",
    object: "",
    visibility: [0, 100],
    decoded: [0, 100],
    reason: "shadow",
    share: [0, 100],
    sort: "id",
    down: false,
    thumb: "thumb.jpg",
  });
  let filter = blank(),
    top = 0,
    drawn = null;

  Graycast.filtered = () => {
    const within = (value, [low, high]) =>
      (low <= 0 && high >= 100) ||
      (value !== null && 100 * value >= low - 1e-9 && 100 * value <= high + 1e-9);
    const rows = Graycast.rows().filter(
      (row) =>
        (!filter.split || row.split === filter.split) &&
        (!filter.object || row.objects[filter.object]) &&
        within(row.visibility, filter.visibility) &&
        within(row.decoded, filter.decoded) &&
        within(row.reasons[filter.reason] ?? 0, filter.share),
    );
    const sign = filter.down ? -1 : 1,
      at = filter.sort;
    return rows.sort((a, b) =>
      a[at] === null ? 1 : b[at] === null ? -1 : sign * (a[at] - b[at]) || a.id - b.id,
    );
  };

  Graycast.showGrid = (section) => {
    const list = el("div", { class: "cards" }),
      told = el("span", { class: "told" });
    section.replaceChildren(
      el(
        "div",
        { class: "filters" },
        controls(() => refill(true)),
        told,
      ),
      list,
    );
    let rows = [],
      shown = new Map(),
      last = "";
    const refill = (fresh) => {
      rows = Graycast.filtered();
      told.textContent = `${Graycast.count(rows.length)} of ${Graycast.count(Graycast.rows().length)} scenes`;
      shown.forEach((card) => card.remove());
      shown = new Map();
      if (fresh) top = 0;
      last = "";
      place();
    };
    const place = () => {
      if (!list.isConnected) return;
      const width = list.clientWidth,
        columns = Math.max(Math.floor((width + GAP) / (CARD_PX + GAP)), 1);
      const [w, h] = Graycast.report.statistics.image_sizes_px[0],
        card = (width - (columns - 1) * GAP) / columns;
      const height = (card * h) / w + BELOW_PX + GAP,
        start = list.getBoundingClientRect().top;
      list.style.height = `${Math.ceil(rows.length / columns) * height}px`;
      const first = Math.max(Math.floor(-start / height) - 1, 0) * columns;
      const end = Math.min((Math.ceil((innerHeight - start) / height) + 1) * columns, rows.length);
      const state = `${first} ${end} ${width}`;
      if (state === last) return;
      last = state;
      const kept = new Map();
      for (let k = first; k < end; k++) {
        const node = shown.get(rows[k].key) ?? makeCard(rows[k]);
        node.style.cssText = `width:${card}px;height:${height - GAP}px;transform:translate(${(k % columns) * (card + GAP)}px,${Math.floor(k / columns) * height}px)`;
        kept.set(rows[k].key, node);
        if (!node.isConnected) list.append(node);
      }
      shown.forEach((node, key) => {
        if (!kept.has(key)) node.remove();
      });
      shown = kept;
    };
    drawn = place;
    refill(false);
    if (top) scrollTo(0, top);
    place();
  };
  addEventListener(
    "scroll",
    () => {
      if (drawn && document.getElementById("grid")) {
        top = scrollY;
        drawn();
      }
    },
    { passive: true },
  );
  addEventListener("resize", () => drawn?.());

  function makeCard(row) {
    const parts = Graycast.report.reasons.map((r) => ({
      name: Graycast.words(r.name),
      color: r.color,
      share: row.reasons[r.name] ?? 0,
    }));
    const image = el("img", {
      loading: "lazy",
      decoding: "async",
      alt: "",
      src: `scenes/${row.key}/${filter.thumb}`,
    });
    return el(
      "a",
      { class: "card", href: `#/${row.key}`, "data-key": row.key },
      image,
      Graycast.stack(parts, "card-bar"),
      el(
        "div",
        { class: "card-line" },
        el("b", {}, row.split === "train" ? String(row.id) : `${row.split} ${row.id}`),
        el("span", {}, `${row.instances} parts`),
        el("span", { title: "decoded share of all pixels" }, percent(row.decoded)),
        el(
          "span",
          { title: "scanner noise on parts" },
          row.sigma_mm === null ? "" : `σ ${row.sigma_mm.toFixed(2)} mm`,
        ),
      ),
    );
  }

  function controls(changed) {
    const { statistics, classes, reasons } = Graycast.report;
    const set = (name) => (event) => {
      filter[name] = event.target.value;
      changed();
    };
    const range = (name, label) =>
      el(
        "label",
        {},
        label,
        ...[0, 1].map((end) =>
          el("input", {
            type: "number",
            min: 0,
            max: 100,
            step: 1,
            value: filter[name][end],
            id: `${name}-${end ? "to" : "from"}`,
            "aria-label": `${label} ${end ? "to" : "from"} %`,
            oninput: (event) => {
              const value = event.target.valueAsNumber;
              filter[name][end] = Number.isNaN(value) ? 100 * end : value;
              changed();
            },
          }),
        ),
        "%",
      );
    const select = (name, label, options) =>
      el(
        "label",
        {},
        label,
        el(
          "select",
          { id: `pick-${name}`, onchange: set(name) },
          options.map(([value, text]) =>
            el("option", { value, selected: filter[name] === value }, text),
          ),
        ),
      );
    const splits = Object.keys(statistics.scenes);
    return [
      splits.length > 1
        ? select("split", "split", [["", "all"], ...splits.map((s) => [s, s])])
        : null,
      Object.keys(classes).length > 1
        ? select("object", "class", [["", "all"], ...Object.entries(classes)])
        : null,
      range("visibility", "visibility"),
      range("decoded", "decoded"),
      select(
        "reason",
        "reason",
        reasons.slice(1).map((r) => [r.name, Graycast.words(r.name)]),
      ),
      range("share", ""),
      select("sort", "sort by", SORTS),
      el(
        "button",
        {
          id: "direction",
          title: "up or down",
          onclick: (event) => {
            filter.down = !filter.down;
            event.target.textContent = filter.down ? "↓" : "↑";
            changed();
          },
        },
        filter.down ? "↓" : "↑",
      ),
      select("thumb", "show", [
        ["thumb.jpg", "colour"],
        ["white.jpg", "white frame"],
        ["reason.png", "reasons"],
      ]),
      el(
        "button",
        {
          id: "reset",
          onclick: () => {
            filter = blank();
            Graycast.showGrid(document.getElementById("grid"));
          },
        },
        "reset",
      ),
    ];
  }
}
