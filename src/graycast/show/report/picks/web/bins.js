"use strict";
// An overview of all bins: the summary, the outcomes, and a card for each bin.

{
  const { el, count, percent, outcomes } = Graycast;
  Graycast.KEYS = {
    "All bins": [["Enter", "opens the bin that has the focus"]],
    "One bin": [
      ["space", "play, stop"],
      ["← →", "attempt before, next attempt"],
      ["↑ ↓", "bin before, next bin"],
      [", .", "a time step back, forward"],
      ["− +", "slower, faster"],
      ["p", "the measured points"],
      ["m", "the true poses of the parts"],
      ["r", "robot"],
      ["b", "bin and table"],
      ["Esc", "back to all bins"],
    ],
    Everywhere: [
      ["t", "light or dark"],
      ["?", "these keys"],
    ],
  };

  const seconds = (value) => `${value.toFixed(2)} s`;

  Graycast.showOverview = (main) => {
    const { name, claim } = Graycast.report;
    document.title = `${name} · graycast`;
    document.getElementById("where").textContent =
      `${name}, made by graycast ${claim.versions.graycast}`;
    main.replaceChildren(
      el(
        "section",
        { class: "facts" },
        facts().map(([term, value]) => el("div", {}, el("dt", {}, term), el("dd", {}, value))),
      ),
      el("section", { class: "tables" }, outcomeTable(), stageTable()),
      el("section", { id: "bins" }),
    );
    list();
  };

  function facts() {
    const { summary: s, claim, parts, bins } = Graycast.report,
      { robot, tool, picking } = claim.config;
    const [rate, low, high] = s.rate;
    return [
      ["picks", `${count(s.picked)} of ${count(s.grips)} grips`],
      ["success", `${percent(rate)}, 95 % interval ${percent(low)} to ${percent(high)}`],
      ["picks per hour from robot motion and scans only", s.picks_per_hour.toFixed(0)],
      ["picks per hour with computing on this machine", s.picks_per_hour_here.toFixed(0)],
      ["bins", `${count(bins.length)}, ${count(s.cleared)} cleared`],
      [
        "parts",
        `${count(s.filled)}: ${count(s.taken)} taken, ${count(s.left)} left, ${count(s.spilled)} spilled`,
      ],
      ["of", parts.map((part) => Graycast.words(part.name)).join(", ")],
      ["robot", `${robot.arm}, ${tool.kind}`],
      ["rig", claim.rig],
      ["detector, depth", `${picking.detector}, ${picking.depth}`],
      ["seed", String(claim.seed)],
    ];
  }

  function outcomeTable() {
    const { summary } = Graycast.report,
      total = Object.values(summary.outcomes).reduce((sum, n) => sum + n, 0);
    return el(
      "table",
      { id: "outcomes" },
      el("caption", {}, `how ${count(total)} attempts ended`),
      Object.entries(summary.outcomes).map(([name, n]) => {
        const one = outcomes.named(name);
        return el(
          "tr",
          { "data-outcome": name },
          el("th", {}, outcomes.swatch(one), name),
          el("td", { class: "number" }, count(n)),
          el("td", { class: "number" }, percent(n / total)),
          el(
            "td",
            { class: "bar-cell" },
            el("i", { style: `width:${(100 * n) / total}%;background:${one.color}` }),
          ),
          el("td", { class: "soft" }, one.meaning),
        );
      }),
    );
  }

  function stageTable() {
    const { summary: s } = Graycast.report,
      attempts = Object.values(s.outcomes).reduce((sum, n) => sum + n, 0);
    const row = (name, value, kind) =>
      el(
        "tr",
        {},
        el("th", {}, name),
        el("td", { class: "number" }, value),
        el("td", { class: "soft" }, kind),
      );
    return el(
      "table",
      { id: "stages" },
      el("caption", {}, "seconds of an attempt"),
      row("scanner", seconds(s.seconds.scan / attempts), "simulated, mean"),
      row("robot", seconds(s.seconds.motion / attempts), "simulated, mean"),
      Object.entries(s.work_s).map(([stage, value]) =>
        row(`computing: ${stage}`, seconds(value), "this machine, median"),
      ),
    );
  }

  function list() {
    const { bins } = Graycast.report;
    const shown = bins.filter((bin) => !outcomes.any() || bin.attempts.some(outcomes.looked));
    document
      .getElementById("bins")
      .replaceChildren(
        el(
          "div",
          { class: "chips", id: "filter" },
          el("em", {}, "show"),
          outcomes.buttons(Graycast.report.summary.outcomes, list),
          outcomes.any()
            ? el("button", { id: "reset", onclick: () => (outcomes.clear(), list()) }, "all")
            : null,
          el("em", {}, `${count(shown.length)} of ${count(bins.length)} bins`),
        ),
        el("div", { id: "bin-list" }, shown.map(card)),
      );
  }

  function card(bin) {
    return el(
      "div",
      { class: "bin", "data-bin": bin.key },
      el(
        "a",
        { href: `#/${bin.key}`, class: "open" },
        bin.attempts.length
          ? el("img", { src: `scenes/${bin.key}/thumb.jpg`, loading: "lazy", alt: "first picture" })
          : null,
        el("b", {}, `bin ${bin.id}`),
        el("span", {}, `${bin.taken} of ${bin.filled} taken`),
        el("em", {}, bin.left ? `${bin.left} left` : "cleared"),
        bin.spilled ? el("em", {}, `${bin.spilled} spilled`) : null,
        el("span", { class: "spring" }),
        el("em", {}, `${bin.seconds.toFixed(1)} s`),
      ),
      el(
        "div",
        { class: "strip" },
        bin.attempts.map((k, i) =>
          el("a", {
            href: `#/${bin.key}/${i}`,
            class: outcomes.looked(k) ? "" : "dim",
            style: `background:${outcomes.of(k).color}`,
            "aria-label": `attempt ${i + 1}: ${outcomes.of(k).name}`,
            onmousemove: (event) => Graycast.tip(event, `attempt ${i + 1}: ${outcomes.of(k).name}`),
            onmouseleave: (event) => Graycast.tip(event, ""),
          }),
        ),
      ),
    );
  }

  Graycast.focusCard = () => {};
  Graycast.gridKey = () => false;
}
