"use strict";
// The values under the pointer, and the figures of the picture.

{
  const { el, live, percent, words } = Graycast,
    { at } = live;

  /** Show the values at a pixel; -1 shows none. */
  live.showReadout = (i) => {
    const on = i >= 0,
      s = live.scene.depth_scale_mm;
    const mm = (value, digits = 2) => (on && value ? `${value.toFixed(digits)} mm` : "–");
    const valuesOf = (of) => {
      const depth = of.depth[i] * s,
        scan = of.scanner[i] * s,
        reason = Graycast.report.reasons.find((r) => r.number === of.reason[i]),
        place = of.positions[live.header.axis]?.[i],
        spread = of.positions[`sigma_${live.header.axis}`]?.[i],
        { low_dn, high_dn } = of.frames.content;
      const dn = (level) =>
        on ? `≈ ${Math.round(low_dn + (high_dn - low_dn) * Graycast.linear(level))} DN` : "–";
      return {
        perfect: mm(depth),
        scanner: mm(scan),
        difference: on && depth && scan ? `${Graycast.signed(scan - depth)} mm` : "–",
        σ: on && scan ? `${of.sigma[i].toFixed(3)} mm` : "–",
        reason: on && reason ? words(reason.name) : "–",
        [live.header.axis]:
          on && place === place ? `${place.toFixed(2)} ± ${spread.toFixed(2)} px` : "–",
        "white frame": dn(of.white[4 * i]),
        "this frame": dn(of.levels[i]),
        part:
          on && of.instance[i]
            ? (live.bodies?.names[of.instance[i] - 1] ?? String(of.instance[i] - 1))
            : "–",
      };
    };
    const columns = live.held
      ? [valuesOf(live.scene), valuesOf(live.held)]
      : [valuesOf(live.scene)];
    const head = el(
      "tr",
      {},
      el(
        "th",
        {},
        on ? `pixel ${i % live.scene.width}, ${Math.floor(i / live.scene.width)}` : "pixel",
      ),
      (live.held ? ["now", "held"] : [""]).map((name) => el("td", {}, name)),
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
  };

  /** Show the figures of the picture, beside those of the held picture. */
  live.showFigures = () => {
    const { figures } = live.header,
      before = live.held?.frames.content.figures;
    const pair = (name, format) =>
      before ? `${format(figures[name])}  |  ${format(before[name])}` : format(figures[name]);
    const mm = (value) => (value === null ? "–" : `${value.toFixed(3)} mm`);
    const rows = [
      [
        "picture",
        `${live.header.samples} of ${live.header.of} samples${live.header.exact ? ", finished" : ""}`,
      ],
      ["decoded on parts", pair("part_decoded", (v) => percent(v))],
      ["median off, on parts", pair("bias_mm", mm)],
      ["σ on parts", pair("sigma_mm", mm)],
      ["exposure", pair("exposure_ms", (v) => `${v.toPrecision(3)} ms`)],
      ["white saturated", pair("saturated", (v) => percent(v))],
      [
        "baseline",
        `${live.header.rig.baseline_mm.toFixed(0)} mm, axes at ${live.header.rig.axes_deg.toFixed(1)}°`,
      ],
    ];
    at("figures").replaceChildren(
      ...rows
        .map(([name, value]) => [el("dt", {}, name), el("dd", { "data-name": name }, value)])
        .flat(),
    );
    showReasons(figures, before);
  };

  /** Show the reasons for missing depth, with their shares. */
  function showReasons(figures, before) {
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
}
