"use strict";
// One bin: the moving robot over the scans, attempt by attempt.

{
  const { el, outcomes, prefs, replay } = Graycast;

  Graycast.showScene = async (main, key, isCurrent) => {
    const [name, text = ""] = key.split("/"),
      bin = Graycast.report.bins.find((one) => one.key === name);
    if (!bin) throw new Error(`there is no ${name} in this report`);
    const number = /^\d+$/.test(text) ? Number(text) : start(bin);
    if (number >= bin.attempts.length)
      throw new Error(`${name} has ${bin.attempts.length} attempts, and no number ${number + 1}`);
    const content =
      replay.open?.bin === bin
        ? replay.open.content
        : await Graycast.bring(`${name}/scene.js`, name);
    const scan = await replay.bringAttempt(bin, number);
    if (!isCurrent()) return;
    if (replay.open?.bin !== bin) await enter(main, bin, content, scan, number, isCurrent);
    if (!isCurrent() || !replay.open) return;
    show(number, scan);
    const next = number + 1;
    if (next < bin.attempts.length) replay.bringAttempt(bin, next).catch(() => {});
  };

  /** Return the first attempt with a selected outcome. */
  const start = (bin) => Math.max(bin.attempts.findIndex(outcomes.looked), 0);

  // --- the page of a bin --------------------------------------------------------------------------

  async function enter(main, bin, content, scan, number, isCurrent) {
    const space = replay.spaceOf(Graycast.report.look, scan),
      mine = { bin, content, number, scan, time: 0 };
    const bodies = await Graycast.makeBodies(space.middle, () => ({
      content,
      attempt: content.attempts[mine.number],
      number: mine.number,
      motion: mine.scan.motion,
      time: mine.time,
    }));
    if (!isCurrent()) return;
    Graycast.closeScene();
    replay.open = mine;
    document.title = `${Graycast.report.name} ${bin.id} · graycast`;
    document.getElementById("where").textContent = `${Graycast.report.name} / bin ${bin.id}`;
    document.getElementById("steps").replaceChildren(...steps(bin));
    replay.open.cloud = Graycast.makeCloud(scan, { space, bodies });
    main.replaceChildren(
      el(
        "section",
        { class: "scene replay" },
        el("div", { class: "toolbars" }, el("div", { class: "options" })),
        el(
          "div",
          { class: "left" },
          el("div", { class: "hold" }, replay.open.cloud.stage),
          el("div", { class: "player" }),
          el("div", { class: "under" }),
        ),
        el(
          "aside",
          {},
          el("div", { id: "ended" }),
          el("img", { id: "attempt-picture", alt: "what the camera saw" }),
          el("table", { id: "attempt-facts" }),
          el("div", { class: "chips", id: "filter" }),
          el("div", { id: "attempts" }),
        ),
      ),
    );
    replay.showLayers();
    replay.showPlayer();
  }

  function steps(bin) {
    const { bins } = Graycast.report,
      at = bins.indexOf(bin);
    const link = (to, id, title, text) =>
      el("a", to ? { href: `#/${to.key}`, id, title } : { class: "off" }, text);
    return [
      link(bins[at - 1], "before", "bin before (↑)", "← bin before"),
      el("span", {}, `${at + 1} of ${bins.length}`),
      link(bins[at + 1], "after", "next bin (↓)", "next bin →"),
    ];
  }

  // --- an attempt ---------------------------------------------------------------------------------

  function show(number, scan) {
    clearTimeout(replay.waiting);
    const another = number !== replay.open.number;
    replay.open.number = number;
    if (replay.open.scan !== scan) {
      replay.open.scan = scan;
      replay.open.cloud.swap(scan);
    }
    if (another) replay.open.time = 0;
    const picture = /** @type {HTMLImageElement} */ (document.getElementById("attempt-picture"));
    picture.src = scan.picture;
    replay.showOutcome();
    replay.showFacts();
    replay.showAttempts();
    replay.showPlayer();
    replay.seek(replay.open.time);
    if (replay.open.goesOn) replay.play(true);
    replay.open.goesOn = false;
  }

  Graycast.closeScene = () => {
    if (!replay.open) return;
    replay.play(false);
    replay.open.cloud.close();
    replay.open = null;
    document.getElementById("steps").replaceChildren();
    Graycast.tip(null, "");
  };

  Graycast.sceneKey = (event) => {
    if (!replay.open) return false;
    const press = (id) => document.getElementById(id)?.click();
    const go = (by) => {
      const next = replay.neighbour(by);
      if (next !== null) location.hash = `#/${replay.open.bin.key}/${next}`;
    };
    if (event.key === " ") replay.play(!replay.running);
    else if (event.key === "ArrowLeft") go(-1);
    else if (event.key === "ArrowRight") go(1);
    else if (event.key === "ArrowUp") press("before");
    else if (event.key === "ArrowDown") press("after");
    else if (event.key === "," || event.key === ".") replay.step(event.key === "." ? 1 : -1);
    else if (event.key === "+" || event.key === "=") replay.changeSpeed(1);
    else if (event.key === "-") replay.changeSpeed(-1);
    else if (event.key === "p") press("toggle-points");
    else if (event.key === "m") press("toggle-parts");
    else if (event.key === "r") press("toggle-robot");
    else if (event.key === "b") press("toggle-bin");
    else return false;
    return true;
  };

  Graycast.redraw = () => replay.open?.cloud.draw(prefs);
}
