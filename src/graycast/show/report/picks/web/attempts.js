"use strict";
// An attempt in words: its outcome and figures, and the list of all attempts of the bin.

{
  const { el, outcomes, replay } = Graycast;

  /** Show an attempt's outcome. */
  replay.showOutcome = () => {
    const { open } = replay,
      attempt = open.content.attempts[open.number],
      one = outcomes.named(attempt.outcome);
    document
      .getElementById("ended")
      .replaceChildren(
        el("h1", {}, outcomes.swatch(one), attempt.outcome),
        el("p", {}, `Attempt ${open.number + 1} of ${open.bin.attempts.length}: ${one.meaning}.`),
        attempt.detail ? el("p", { class: "soft" }, attempt.detail) : "",
      );
  };

  /** Show an attempt's figures. */
  replay.showFacts = () => {
    const { open } = replay,
      attempt = open.content.attempts[open.number],
      { parts } = Graycast.report,
      error = attempt.pose_error,
      work = Object.entries(attempt.work_s);
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
      ["machine", work.map(([stage, s]) => `${stage} ${s.toFixed(2)}`).join(", ") + " s"],
    ].filter(([, value]) => value !== null && value !== undefined);
    document
      .getElementById("attempt-facts")
      .replaceChildren(
        ...lines.map(([name, value]) => el("tr", {}, el("th", {}, name), el("td", {}, value))),
      );
  };

  function tally() {
    /** @type {Record<string, number>} */
    const counts = {};
    for (const { outcome } of replay.open.content.attempts)
      counts[outcome] = (counts[outcome] ?? 0) + 1;
    return counts;
  }

  /** List the attempts with a selected outcome, and the present attempt. */
  replay.showAttempts = () => {
    const { open } = replay;
    document
      .getElementById("filter")
      .replaceChildren(...outcomes.buttons(tally(), replay.showAttempts));
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
  };
}
