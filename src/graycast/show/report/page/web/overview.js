"use strict";
// An overview of the dataset: facts, plots, and the grid of scenes below them.

{
  const { el, count, percent } = Graycast;
  const CLASS_COLORS = [
    "#3b8ea5",
    "#d07a3e",
    "#5aa06f",
    "#8f6fc0",
    "#c8385a",
    "#a08a34",
    "#4a6fb0",
    "#b0698f",
  ];
  const ACCENT = CLASS_COLORS[0],
    SECOND = CLASS_COLORS[1];

  Graycast.showOverview = (main) => {
    const { statistics, name } = Graycast.report;
    document.title = `${name} · graycast`;
    const version = Graycast.report.claim.versions?.graycast;
    document.getElementById("where").textContent = version
      ? `${name}, made by graycast ${version}`
      : name;
    main.replaceChildren(
      el(
        "section",
        { class: "facts" },
        facts().map(([term, value]) => el("div", {}, el("dt", {}, term), el("dd", {}, value))),
      ),
      ...[Graycast.found.told()].filter(Boolean),
      figures(statistics),
      el("section", { id: "grid" }),
    );
    drawPlots();
    Graycast.showGrid(document.getElementById("grid"));
  };

  /** Return plots of quantities that vary, and one line of text for constant quantities. */
  function figures(statistics) {
    const all = plots(statistics),
      constant = all.map((one) => Graycast.onlyValue(one)).filter(Boolean);
    varying = all.filter((one) => !Graycast.onlyValue(one));
    const said = constant.length
      ? el("p", { id: "constant" }, `Not plotted, as all values are equal: ${constant.join(" · ")}`)
      : null;
    return el(
      "details",
      {
        class: "figures",
        open: shut() ? null : true,
        ontoggle: () => dispatchEvent(new Event("resize")), // The grid has moved.
      },
      el("summary", { onclick: (event) => keepShut(event.target.parentElement.open) }, "figures"),
      el("section", { class: "plots" }),
      said,
    );
  }

  const SHUT = "graycast-figures-shut";
  const LOW_PX = 850; // In a lower window, open figures would leave no room for scenes.
  function shut() {
    let chosen = null;
    try {
      chosen = localStorage.getItem(SHUT);
    } catch {
      /* The browser stores nothing. */
    }
    return chosen ? chosen === "yes" : innerHeight < LOW_PX;
  }
  function keepShut(isShut) {
    try {
      localStorage.setItem(SHUT, isShut ? "yes" : "no");
    } catch {
      /* The browser stores nothing. */
    }
  }

  const TILE_PX = 290,
    GAP_PX = 10,
    INSIDE_PX = 22;
  let varying = []; // the plots to draw

  /** Fill rows with equal numbers of tiles, and fit each plot to its tile. */
  function drawPlots() {
    const section = /** @type {HTMLElement} */ (document.querySelector(".plots")),
      room = section?.clientWidth;
    if (!room || section.dataset.room === String(room)) return;
    const most = Math.max(Math.floor((room + GAP_PX) / (TILE_PX + GAP_PX)), 1),
      rows = Math.ceil(varying.length / most),
      columns = Math.max(Math.ceil(varying.length / Math.max(rows, 1)), 1);
    section.dataset.room = String(room);
    section.style.setProperty("--columns", String(columns));
    const width = Math.floor((room + GAP_PX) / columns) - GAP_PX - INSIDE_PX;
    section.replaceChildren(...varying.map((one) => one.draw(width)));
  }
  addEventListener("resize", drawPlots);

  function facts() {
    const { statistics: s, claim, scanners } = Graycast.report;
    const scenes = Object.entries(s.scenes),
      total = scenes.reduce((sum, [, n]) => sum + n, 0);
    const list = [
      [
        "scenes",
        scenes.length > 1
          ? `${count(total)} (${scenes.map(([k, n]) => `${n} ${k}`).join(", ")})`
          : count(total),
      ],
      [
        "instances",
        `${count(s.classes.reduce((sum, c) => sum + c.instances, 0))} of ${s.classes.length} ${s.classes.length === 1 ? "class" : "classes"}`,
      ],
      [
        "pictures",
        (s.pictures > total ? `${count(s.pictures)}, ` : "") +
          s.image_sizes_px.map(([w, h]) => `${w} × ${h} px`).join(", "),
      ],
    ];
    for (const [name, { rig, code }] of Object.entries(scanners)) {
      const of = name ? ` of ${name}` : "";
      if (rig) {
        const t = rig.T_cam_proj,
          baseline = Math.hypot(t[0][3], t[1][3], t[2][3]);
        list.push([`rig${of}`, `${rig.name}, baseline ${(1000 * baseline).toFixed(0)} mm`]);
      }
      if (code)
        list.push([`code${of}`, `${Graycast.words(code.codec)}, ${code.frames.length} frames`]);
    }
    list.push([
      "decoded",
      `${percent(s.part_reasons.decoded)} of parts' pixels, ${percent(s.reasons.decoded)} of all`,
    ]);
    const note = Graycast.report.note;
    if (note) list.push(["note", `${note}; graycast preview tries what helps`]);
    if (s.part_error.pixels)
      list.push([
        "scanner error on parts",
        `σ ${s.part_error.sigma_mm.toFixed(3)}, median ${Graycast.signed(s.part_error.median_mm, 3)} mm`,
      ]);
    if (claim.seed !== undefined) list.push(["seed", String(claim.seed)]);
    return list;
  }

  function plots(s) {
    const out = [reasonPlot(s)];
    if (s.part_error.pixels) out.push(errorPlot(s));
    out.push(visibilityPlot(s), sizePlot(s), instancePlot(s));
    if (Object.keys(s.depth_counts).length) out.push(depthPlot(s));
    out.push(decodedPlot(s), brightnessPlot(s));
    return out;
  }

  /** Describe a plot: {bins, series, say, title, unit} for texts, and draw() for the picture. */
  const histogram = (what) => ({ ...what, draw: (width) => Graycast.plot({ ...what, width }) });
  const shares = (what) => ({ ...what, draw: () => Graycast.shares(what) });

  const reasonPlot = (s) => {
    const parts = (shares) =>
      Graycast.report.reasons.map((r) => ({
        name: Graycast.words(r.name),
        color: r.color,
        share: shares[r.name] ?? 0,
      }));
    return shares({
      title: "Why there is no depth",
      note: "parts · all pixels",
      rows: [
        { name: "parts", parts: parts(s.part_reasons) },
        { name: "all", parts: parts(s.reasons) },
      ],
    });
  };

  const classes = (s, key) =>
    s.classes.map((c, k) => ({
      name: c.name,
      color: CLASS_COLORS[k % CLASS_COLORS.length],
      values: c[key],
    }));

  const visibilityPlot = (s) =>
    histogram({
      title: "Visibility",
      note: "visible share of the silhouette",
      unit: "%",
      y: "instances",
      bins: s.visib_fract_edges
        .slice(1)
        .map((to, k) => ({ from: 100 * s.visib_fract_edges[k], to: 100 * to })),
      series: classes(s, "visib_fract"),
    });

  function sizePlot(s) {
    const total =
      s.classes[0]?.side_px.map((_, k) => s.classes.reduce((sum, c) => sum + c.side_px[k], 0)) ??
      [];
    const first = Math.max(
      total.findIndex((n) => n > 0),
      0,
    );
    const last =
      total.length -
      1 -
      Math.max(
        [...total].reverse().findIndex((n) => n > 0),
        0,
      );
    const bins = s.side_edges_px.slice(first, last + 1).map((from, k) => ({
      from,
      to: s.side_edges_px[first + k + 1],
      label: `${from.toFixed(0)} to ${s.side_edges_px[first + k + 1].toFixed(0)}`,
    }));
    const series = classes(s, "side_px").map((one) => ({
      ...one,
      values: one.values.slice(first, last + 1),
    }));
    return histogram({
      title: "Mask size",
      note: "root of the visible area",
      unit: "px",
      y: "instances",
      bins,
      series,
      even: true,
    });
  }

  function instancePlot(s) {
    const numbers = Object.keys(s.instances_per_scene).map(Number);
    const low = Math.max(Math.min(...numbers) - 3, 0),
      high = Math.max(...numbers) + 3,
      width = Math.max(1, Math.ceil((high - low + 1) / 40));
    const bins = [],
      values = [];
    for (let from = low; from <= high; from += width) {
      bins.push({
        from: from - 0.5,
        to: from + width - 0.5,
        label: width === 1 ? `${from}` : `${from} to ${from + width - 1}`,
      });
      values.push(
        numbers
          .filter((n) => n >= from && n < from + width)
          .reduce((sum, n) => sum + s.instances_per_scene[n], 0),
      );
    }
    return histogram({
      title: "Instances per scene",
      unit: "instances",
      y: "scenes",
      bins,
      series: [{ color: ACCENT, values }],
    });
  }

  const share = (value) => `${+(100 * value).toPrecision(2)} %`;

  function depthPlot(s) {
    const width = s.depth_bin_mm,
      step = Math.max(1, Math.ceil((s.depth_mm.p99 - s.depth_mm.p01) / width / 60));
    const low = Math.floor((s.depth_mm.p01 - 2 * width) / width / step),
      high = Math.ceil((s.depth_mm.p99 + 2 * width) / width / step);
    const bins = [],
      values = [];
    for (let k = low; k < high; k++) {
      bins.push({ from: k * step * width, to: (k + 1) * step * width });
      let sum = 0;
      for (let j = k * step; j < (k + 1) * step; j++) sum += s.depth_counts[j] ?? 0;
      values.push(sum / s.pixels);
    }
    return histogram({
      title: "Perfect depth",
      unit: "mm",
      y: "pixels",
      say: share,
      bins,
      series: [{ color: ACCENT, values }],
    });
  }

  const sum = (list) => list.reduce((a, b) => a + b, 0);

  /** Return the error, in steps, that the given share of the errors does not exceed. */
  function within(counts, share) {
    const sizes = Object.entries(counts)
      .map(([k, c]) => [Math.abs(Number(k)), c])
      .sort((a, b) => a[0] - b[0]);
    let left = share * sum(sizes.map(([, c]) => c));
    return sizes.find(([, c]) => (left -= c) <= 0)?.[0] ?? 0;
  }

  function errorPlot(s) {
    // Some wrong points are far away, so the plot covers only the range of most points.
    const step = s.error_step_mm,
      most = Math.max(2 * within(s.error_counts, 0.95), 2 * within(s.part_error_counts, 0.75)),
      reach = Math.max(most * step, 3 * step);
    const many = Math.max(Math.round((2 * reach) / 61 / step), 1),
      width = many * step; // Whole steps avoid moiré.
    const n = Math.ceil(reach / width),
      bins = [];
    for (let k = -n; k <= n; k++)
      bins.push({
        from: (k - 0.5) * width,
        to: (k + 0.5) * width,
        label: `${Graycast.signed(k * width)}`,
      });
    const beyond = (counts) => {
      const outside = Object.entries(counts).filter(
        ([k]) => Math.abs(Math.round(Number(k) / many)) > n,
      );
      return percent(sum(outside.map(([, c]) => c)) / sum(Object.values(counts)));
    };
    const spread = (counts) => {
      const values = bins.map(() => 0),
        total = sum(Object.values(counts));
      for (const [k, c] of Object.entries(counts)) {
        const bin = Math.round(Number(k) / many) + n;
        if (bin >= 0 && bin < bins.length) values[bin] += c / total;
      }
      return values;
    };
    return histogram({
      title: "Scanner error",
      note: `beyond the plot: ${beyond(s.part_error_counts)} of parts, ${beyond(s.error_counts)} of all`,
      unit: "mm",
      y: "pixels",
      lines: true,
      say: share,
      bins,
      series: [
        { name: "parts", color: ACCENT, values: spread(s.part_error_counts) },
        { name: "all", color: SECOND, values: spread(s.error_counts) },
      ],
    });
  }

  const decodedPlot = (s) =>
    histogram({
      title: "Decoded share of parts",
      unit: "% of the parts' pixels",
      y: "scenes",
      bins: s.decoded_share_counts.map((_, k) => ({ from: 2 * k, to: 2 * k + 2 })),
      series: [{ color: ACCENT, values: s.decoded_share_counts }],
    });

  function brightnessPlot(s) {
    const series = [
      ["white frame", s.white_frame_counts, ACCENT],
      ["colour picture", s.luma_counts, SECOND],
    ]
      .filter(([, counts]) => Object.keys(counts).length)
      .map(([name, counts, color]) => {
        const values = new Array(64).fill(0),
          total = Object.values(counts).reduce((a, b) => a + b, 0);
        for (const [level, c] of Object.entries(counts)) values[Number(level) >> 2] += c / total;
        return { name, color, values };
      });
    return histogram({
      title: "Brightness",
      unit: "of 255",
      y: "pixels",
      lines: true,
      say: share,
      series,
      bins: Array.from({ length: 64 }, (_, k) => ({ from: 4 * k, to: 4 * k + 4 })),
    });
  }
}
