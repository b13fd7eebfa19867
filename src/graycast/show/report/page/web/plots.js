"use strict";
// Small plots as SVG, with the page's colours and values at the pointer.

{
  const { el } = Graycast;
  const H = 150,
    LEFT = 34,
    BOTTOM = 30,
    TOP = 18,
    RIGHT = 14;

  /** Return round numbers that divide a range into about `count` parts. */
  function ticks(low, high, count = 4) {
    const raw = (high - low) / count,
      power = 10 ** Math.floor(Math.log10(raw || 1));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999) ?? power;
    const out = [];
    for (let t = Math.ceil(low / step - 1e-9) * step; t <= high + step * 1e-6; t += step)
      out.push(Math.abs(t) < step * 1e-6 ? 0 : t);
    return out;
  }
  const short = (value) =>
    Math.abs(value) >= 1e6
      ? `${+(value / 1e6).toPrecision(3)}M`
      : Math.abs(value) >= 1e4
        ? `${+(value / 1e3).toPrecision(3)}k`
        : `${+value.toPrecision(4)}`;

  const binWords = (bin, unit) =>
    `${bin.label ?? `${short(bin.from)} to ${short(bin.to)}`} ${unit}`;

  /** Describe a quantity that has only one bin and needs no plot; null for others. */
  Graycast.onlyValue = ({ title, unit, bins, series, rows }) => {
    if (rows) {
      const names = rows.map((row) => row.parts.filter((p) => p.share > 0).map((p) => p.name));
      const all = new Set(names.flat());
      return all.size === 1 ? `every pixel is ${[...all][0]}` : null;
    }
    const filled = bins.filter((_, k) => series.some((s) => s.values[k] > 0));
    if (filled.length > 1) return null;
    const words = title[0].toLowerCase() + title.slice(1),
      value = filled.length ? binWords(filled[0], words.startsWith(unit) ? "" : unit) : "not known";
    return `${words}: ${value.trim()}`;
  };

  /**
   * Plot series over shared bins.
   * bins: [{from, to, label}], series: [{name, color, values}], as stacked bars or lines.
   * `even` gives all bins the same width. `say(value)` formats a value. `width` is the picture's
   * [px].
   */
  Graycast.plot = ({
    title,
    note,
    unit,
    y,
    bins,
    series,
    lines = false,
    even = false,
    say = short,
    width: W,
  }) => {
    const svg = el("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": title });
    const total = bins.map((_, k) =>
      lines
        ? Math.max(...series.map((s) => s.values[k]))
        : series.reduce((sum, s) => sum + s.values[k], 0),
    );
    const top = Math.max(...total, 1e-12);
    const low = bins[0].from,
      high = bins[bins.length - 1].to;
    const px = (k, value) =>
      LEFT + (W - LEFT - RIGHT) * (even ? k / bins.length : (value - low) / (high - low));
    const py = (value) => H - BOTTOM - ((H - BOTTOM - TOP) * value) / top;
    for (const t of ticks(0, top, 3)) {
      svg.append(
        el("line", { class: "grid", x1: LEFT, x2: W - RIGHT, y1: py(t), y2: py(t) }),
        el("text", { class: "tick", x: LEFT - 4, y: py(t) + 3, "text-anchor": "end" }, say(t)),
      );
    }
    if (even) {
      const every = Math.ceil(bins.length / 6);
      bins.forEach((bin, k) => {
        if (k % every === 0)
          svg.append(
            el(
              "text",
              { class: "tick", x: px(k), y: H - BOTTOM + 12, "text-anchor": "middle" },
              short(Math.round(bin.from)),
            ),
          );
      });
    } else {
      for (const t of ticks(low, high))
        svg.append(
          el(
            "text",
            { class: "tick", x: px(0, t), y: H - BOTTOM + 12, "text-anchor": "middle" },
            short(t),
          ),
        );
    }
    const base = bins.map(() => 0);
    for (const s of series) {
      if (lines) {
        const d = bins
          .map(
            (bin, k) =>
              `${k ? "L" : "M"}${px(k, bin.from).toFixed(1)} ${py(s.values[k]).toFixed(1)}H${px(k + 1, bin.to).toFixed(1)}`,
          )
          .join("");
        svg.append(el("path", { d, fill: "none", stroke: s.color, "stroke-width": 1.3 }));
        continue;
      }
      bins.forEach((bin, k) => {
        if (!s.values[k]) return;
        const x = px(k, bin.from),
          width = Math.max(px(k + 1, bin.to) - x - 0.6, 0.6);
        svg.append(
          el("rect", {
            x,
            width,
            y: py(base[k] + s.values[k]),
            height: py(base[k]) - py(base[k] + s.values[k]),
            fill: s.color,
          }),
        );
        base[k] += s.values[k];
      });
    }
    svg.append(
      el("line", { class: "axis", x1: LEFT, x2: W - RIGHT, y1: H - BOTTOM, y2: H - BOTTOM }),
      el("text", { class: "tick", x: W - RIGHT, y: H - 4, "text-anchor": "end" }, unit),
      el("text", { class: "tick", x: 2, y: 9 }, y),
    );
    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect(),
        at = ((event.clientX - box.left) / box.width) * W;
      const k = bins.findIndex((bin, i) => at >= px(i, bin.from) && at < px(i + 1, bin.to));
      const names =
        series.length > 1
          ? series.filter((s) => s.values[k]).map((s) => `${s.name} ${say(s.values[k])}`)
          : k >= 0
            ? [say(series[0].values[k])]
            : [];
      Graycast.tip(event, k < 0 ? "" : `${binWords(bins[k], unit)}: ${names.join(", ") || say(0)}`);
    });
    svg.addEventListener("pointerleave", (event) => Graycast.tip(event, ""));
    return frame(title, note, svg, series.length > 1 && series.length <= 8 ? series : []);
  };

  /** Show shares of a whole as one bar per row: [{name, parts: [{name, color, share}]}]. */
  Graycast.shares = ({ title, note, rows }) => {
    const bars = rows.map((row) =>
      el("div", { class: "share-row" }, el("span", {}, row.name), stack(row.parts, "share-bar")),
    );
    const used = rows[0].parts.filter((_, k) => rows.some((row) => row.parts[k].share >= 0.0005));
    return frame(title, note, el("div", { class: "shares" }, bars), used, rows);
  };

  const stack = (parts, name) =>
    el(
      "div",
      { class: name },
      parts
        .filter((p) => p.share > 0)
        .map((p) =>
          el("i", {
            style: `width:${(100 * p.share).toFixed(3)}%;background:${p.color}`,
            onpointermove: (event) =>
              Graycast.tip(event, `${p.name} ${Graycast.percent(p.share, 2)}`),
            onpointerleave: (event) => Graycast.tip(event, ""),
          }),
        ),
    );
  Graycast.stack = stack;

  function frame(title, note, body, legend, rows) {
    const told = (one) =>
      rows
        ? ` ${rows.map((row) => Graycast.percent(row.parts.find((p) => p.name === one.name).share)).join(" · ")}`
        : "";
    return el(
      "figure",
      { class: "plot" },
      el("figcaption", {}, el("b", {}, title), note ? el("span", {}, note) : null),
      body,
      legend.length
        ? el(
            "div",
            { class: "legend" },
            legend.map((one) =>
              el(
                "span",
                {},
                el("i", { style: `background:${one.color}` }),
                one.name,
                el("em", {}, told(one)),
              ),
            ),
          )
        : null,
    );
  }
}
