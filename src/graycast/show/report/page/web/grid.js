"use strict";
// The grid of scenes: only visible cards exist in the page; cards can be focused, ticked and
// tagged.

{
  const { el, percent, tags } = Graycast;
  const GAP = 10,
    CARD_PX = 208,
    MOST_NAMES = 4;
  let top = 0,
    open = null, // the grid that is shown
    at = null, // the key of the card that has the keyboard's focus
    from = null, // the first card of a range that is ticked with shift
    longest = null; // the rows with the most text below their picture

  Graycast.showGrid = (section) => {
    const list = el("div", { class: "cards" }),
      nothing = el("div", { class: "nothing", hidden: true });
    const bar = Graycast.filterBar(() => refill(true));
    open = { list, nothing, bar, rows: [], shown: new Map(), last: "", columns: 1, height: 1 };
    section.replaceChildren(bar.element, nothing, list, el("div", { id: "ticked", hidden: true }));
    refill(false);
    if (top) scrollTo(0, top);
    place();
  };

  /** Draw the cards again after a change of a filter, a tick or a tag. */
  function refill(fresh) {
    open.rows = Graycast.filtered();
    open.bar.tell(open.rows);
    open.shown.forEach((card) => card.remove());
    open.shown = new Map();
    if (fresh) top = 0;
    open.last = "";
    open.nothing.hidden = open.rows.length > 0;
    if (!open.rows.length) open.nothing.replaceChildren(...nothingFits());
    place();
    tickedBar();
  }

  const nothingFits = () => [
    el("p", {}, "No scene matches all of these filters."),
    el(
      "button",
      { id: "lift-all", onclick: () => open.bar.lift(Graycast.liftAll()) },
      "remove all filters",
    ),
  ];

  function place() {
    const { list, rows } = open;
    if (!list.isConnected) return;
    const width = list.clientWidth,
      columns = Math.max(Math.floor((width + GAP) / (CARD_PX + GAP)), 1);
    const [w, h] = Graycast.report.statistics.image_sizes_px[0],
      card = (width - (columns - 1) * GAP) / columns;
    if (open.width !== width) Object.assign(open, { width, text: textHeight(list, card) });
    const height = (card * h) / w + open.text + GAP,
      start = list.getBoundingClientRect().top;
    Object.assign(open, { columns, height });
    list.style.height = `${Math.ceil(rows.length / columns) * height}px`;
    const first = Math.max(Math.floor(-start / height) - 1, 0) * columns;
    const end = Math.min((Math.ceil((innerHeight - start) / height) + 1) * columns, rows.length);
    const state = `${first} ${end} ${width}`;
    if (state === open.last) return;
    open.last = state;
    const kept = new Map();
    for (let k = first; k < end; k++) {
      const node = open.shown.get(rows[k].key) ?? makeCard(rows[k]);
      node.style.cssText = `width:${card}px;height:${height - GAP}px;transform:translate(${(k % columns) * (card + GAP)}px,${Math.floor(k / columns) * height}px)`;
      kept.set(rows[k].key, node);
      if (!node.isConnected) list.append(node);
    }
    open.shown.forEach((node, key) => {
      if (!kept.has(key)) node.remove();
    });
    open.shown = kept;
  }
  addEventListener(
    "scroll",
    () => {
      if (open && document.getElementById("grid")) {
        top = scrollY;
        place();
      }
    },
    { passive: true },
  );
  addEventListener("resize", () => open && place());

  /** Return the height of the highest text below a picture. */
  function textHeight(list, card) {
    longest ??= Graycast.rows()
      .map((row) => ({
        row,
        long: partLines(row).reduce((sum, line) => sum + 20 + line.length, 0),
      }))
      .sort((a, b) => b.long - a.long)
      .slice(0, 3)
      .map(({ row }) => row);
    const probes = longest.map((row) =>
      el("div", { class: "card", style: `width:${card}px` }, text(row)),
    );
    list.append(...probes);
    const height = Math.max(...probes.map((probe) => probe.offsetHeight));
    probes.forEach((probe) => probe.remove());
    return height;
  }

  // --- a card -------------------------------------------------------------------------------------

  const title = (row) =>
    `${row.split === "train" ? "scene" : row.split} ${row.id}${row.picture ? ` · ${row.picture}` : ""}`;

  /** Return the number of parts of each kind, most frequent first. */
  function partLines(row) {
    const names = Graycast.report.classes,
      counts = Object.entries(row.objects).sort(([, a], [, b]) => b - a);
    const lines = counts
      .slice(0, MOST_NAMES)
      .map(([id, n]) => `${n} × ${names[id] ?? `object ${id}`}`);
    if (counts.length > MOST_NAMES) lines.push(`and ${counts.length - MOST_NAMES} more kinds`);
    return lines.length ? lines : ["no parts"];
  }

  const text = (row) => [
    Graycast.stack(
      Graycast.report.reasons.map((r) => ({
        name: Graycast.words(r.name),
        color: r.color,
        share: Graycast.ownReasons(row)[r.name] ?? 0,
      })),
      "card-bar",
    ),
    el(
      "div",
      { class: "card-text" },
      el(
        "div",
        { class: "card-head" },
        el("b", {}, title(row)),
        row.part_decoded === null
          ? el("span", { title: "decoded share of all pixels" }, `${percent(row.decoded)} of all`)
          : el(
              "span",
              { title: "share of the parts' visible pixels that have depth" },
              `${percent(row.part_decoded)} of parts`,
            ),
      ),
      partLines(row).map((line) => el("div", { class: "part" }, line)),
      Graycast.found.line(row),
      row.sigma_mm === null
        ? null
        : el("div", { class: "noise" }, `noise on parts σ ${row.sigma_mm.toFixed(2)} mm`),
    ),
  ];

  function makeCard(row) {
    const { key } = row,
      ticked = tags.ticked.has(key);
    const card = el(
      "div",
      { class: "card", "data-key": key, "data-ticked": ticked },
      el(
        "a",
        { href: `#/${key}`, tabindex: at === key ? 0 : -1, onfocus: () => (at = key) },
        el("img", {
          loading: "lazy",
          decoding: "async",
          alt: title(row),
          src: `scenes/${key}/${Graycast.thumbName()}`,
        }),
        text(row),
      ),
      el("button", {
        class: "tick-box",
        title: "tick this scene (x); with shift, all from the last one",
        "aria-label": `tick ${title(row)}`,
        "aria-pressed": String(ticked),
        onclick: (event) => tick(key, event.shiftKey),
      }),
      el("div", { class: "chips" }, tags.chips(tags.of(key).map((tag) => [tag]))),
    );
    return card;
  }

  // --- ticks and tags -------------------------------------------------------------------------------

  function tick(key, span) {
    const keys = open.rows.map((row) => row.key),
      [a, b] = [keys.indexOf(from), keys.indexOf(key)],
      on = !tags.ticked.has(key);
    const some = span && a >= 0 ? keys.slice(Math.min(a, b), Math.max(a, b) + 1) : [key];
    for (const one of some) tags.tick(one, on);
    from = key;
    renew();
  }

  /** Update ticks and tags without scrolling. */
  function renew() {
    const focused = /** @type {HTMLElement | undefined} */ (
      document.activeElement?.closest(".card")
    )?.dataset.key;
    open.bar.renew();
    refill(false);
    if (focused) open.shown.get(focused)?.querySelector("a").focus({ preventScroll: true });
  }

  /** Fill the bar at the bottom, for the ticked scenes. */
  function tickedBar() {
    const bar = document.getElementById("ticked"),
      keys = [...tags.ticked];
    bar.hidden = !keys.length;
    if (!keys.length) return bar.replaceChildren();
    const shown = new Set(open.rows.map((row) => row.key)),
      hidden = keys.filter((key) => !shown.has(key)).length;
    const held = tags.among(keys).map(([tag, n]) => [tag, `${tag} (${n})`]);
    const rest = open.rows.length + hidden > keys.length;
    bar.replaceChildren(
      ...[
        el("b", {}, `${keys.length} ticked`),
        hidden ? el("span", {}, `${hidden} of them are not shown`) : null,
        el(
          "span",
          { class: "chips" },
          tags.chips(held, (tag) => {
            tags.remove(keys, tag);
            renew();
          }),
        ),
        tags.field("tag-ticked", (list) => {
          tags.add(keys, list);
          renew();
        }),
        rest
          ? el(
              "button",
              {
                id: "tick-all",
                onclick: () => {
                  for (const row of open.rows) tags.tick(row.key, true);
                  renew();
                },
              },
              "tick all shown",
            )
          : null,
        el(
          "button",
          {
            id: "untick",
            onclick: () => {
              tags.ticked.clear();
              renew();
            },
          },
          "untick all",
        ),
        tags.forgetful
          ? el(
              "span",
              {},
              "This browser does not store tags of pages from the disk: save them as a file.",
            )
          : null,
      ].filter(Boolean),
    );
  }

  // --- keys -----------------------------------------------------------------------------------------

  /** Handle a key, and return true if it belongs to the grid. */
  Graycast.gridKey = (event) => {
    if (!open?.list.isConnected) return false;
    const { columns, rows } = open,
      now = rows.findIndex((row) => row.key === at);
    const step = {
      ArrowLeft: -1,
      ArrowRight: 1,
      ArrowUp: -columns,
      ArrowDown: columns,
      Home: -Infinity,
      End: Infinity,
    }[event.key];
    if (event.key === "/") document.getElementById("find").focus();
    else if (event.key === "g" && tags.ticked.size) document.getElementById("tag-ticked").focus();
    else if (event.key === "x" && now >= 0) tick(at, event.shiftKey);
    else if (event.key === "X" && now >= 0) tick(at, true);
    else if (event.key === "Escape" && tags.ticked.size) document.getElementById("untick").click();
    else if (step && rows.length) go(now, step);
    else return false;
    return true;
  };

  /** Move the focus to the first visible card, or onwards from the present card. */
  function go(now, step) {
    const { rows, list, columns, height } = open,
      start = list.getBoundingClientRect().top,
      bars = document.querySelector(".filters").getBoundingClientRect().bottom;
    const seen = Math.max(Math.ceil((bars - start) / height - 0.5), 0) * columns;
    let next = now < 0 && Number.isFinite(step) ? seen : now + step;
    const last = Math.floor(now / columns) === Math.floor((rows.length - 1) / columns);
    if (now >= 0 && ((step === -columns && next < 0) || (step === columns && last))) next = now;
    next = Math.max(0, Math.min(rows.length - 1, next));
    at = rows[next].key;
    const above = start + Math.floor(next / columns) * height,
      bar = /** @type {HTMLElement} */ (document.querySelector(".filters")),
      head = bar.offsetHeight + 60;
    if (above < head) scrollBy(0, above - head);
    else if (above + height > innerHeight - 50) scrollBy(0, above + height - innerHeight + 50);
    place();
    for (const [key, card] of open.shown) card.querySelector("a").tabIndex = key === at ? 0 : -1;
    open.shown.get(at)?.querySelector("a").focus({ preventScroll: true });
  }

  /** Set the focus to the card of the scene that was shown last. */
  Graycast.cameFrom = (key) => {
    at = key;
  };
  Graycast.focusCard = () => {
    if (at && open.rows.some((row) => row.key === at))
      go(
        open.rows.findIndex((r) => r.key === at),
        0,
      );
  };
}
