"use strict";
// The outcomes of attempts: the selected ones, and the buttons that select them.

{
  const { el } = Graycast;
  /** @type {Outcomes} */
  const outcomes = /** @type {any} */ ({});
  Graycast.outcomes = outcomes;
  const chosen = new Set(); // numbers of the selected outcomes; if empty, all are shown

  outcomes.of = (k) => Graycast.report.outcomes[k];
  outcomes.named = (name) => Graycast.report.outcomes.find((one) => one.name === name);
  outcomes.number = (name) => Graycast.report.outcomes.findIndex((one) => one.name === name);
  outcomes.looked = (k) => !chosen.size || chosen.has(k);
  outcomes.any = () => chosen.size > 0;
  outcomes.clear = () => chosen.clear();

  outcomes.swatch = (one) => el("i", { class: "swatch", style: `background:${one.color}` });

  /** Return a button for each outcome with its count; `changed` is called after a click. */
  outcomes.buttons = (counts, changed) =>
    Object.entries(counts).map(([name, count]) => {
      const k = outcomes.number(name);
      return el(
        "button",
        {
          class: "outcome",
          "data-outcome": name,
          "aria-pressed": String(chosen.has(k)),
          title: outcomes.of(k).meaning,
          onclick: () => {
            if (!chosen.delete(k)) chosen.add(k);
            changed();
          },
        },
        outcomes.swatch(outcomes.of(k)),
        `${name} ${count}`,
      );
    });
}
