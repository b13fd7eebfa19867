"use strict";
// The filters and the order of the scenes in the grid, with their controls.

{
  const { el, words } = Graycast;
  const SORTS = [
    ["id", "number"],
    ["part_decoded", "depth on parts, worst first"],
    ["decoded", "decoded, all pixels"],
    ["visibility", "mean visibility"],
    ["instances", "parts in the scene"],
    ["depth_mm", "median depth"],
    ["sigma_mm", "scanner noise on parts"],
    ["bias_mm", "scanner bias on parts"],
    ["brightness", "white frame's brightness"],
    ...Graycast.found.SORTS,
  ];
  const THUMBS = [
    ["thumb.jpg", "colour"],
    ["white.jpg", "white frame"],
    ["reason.png", "reasons"],
  ];
  const KEPT = ["sort", "down", "thumb"]; // These remain when filters are removed.
  const blank = () => ({
    find: "",
    split: "",
    object: "",
    tag: "",
    visibility: [0, 100],
    decoded: [0, 100],
    reason: "shadow",
    share: [0, 100],
    found: "",
    sort: "id",
    down: false,
    thumb: "thumb.jpg",
  });
  let filter = blank();
  /** @type {(range: number[]) => boolean} */
  const whole = ([low, high]) => low <= 0 && high >= 100;

  Graycast.thumbName = () => filter.thumb;

  Graycast.filtered = () => {
    /** @type {(value: number | null, range: number[]) => boolean} */
    const within = (value, [low, high]) =>
      whole([low, high]) ||
      (value !== null && 100 * value >= low - 1e-9 && 100 * value <= high + 1e-9);
    const asked = filter.find.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = Graycast.rows().filter(
      (row) =>
        (!filter.split || row.split === filter.split) &&
        (!filter.object || row.objects[filter.object]) &&
        tagged(row.key) &&
        Graycast.found.fits(row, filter.found) &&
        asked.every((word) => found(row, word)) &&
        within(row.visibility, filter.visibility) &&
        within(row.part_decoded ?? row.decoded, filter.decoded) &&
        within(Graycast.ownReasons(row)[filter.reason] ?? 0, filter.share),
    );
    const sign = filter.down ? -1 : 1,
      at = filter.sort,
      value = (row) => (at in row ? row[at] : Graycast.found.count(row, at));
    return rows.sort((a, b) =>
      value(a) === null ? 1 : value(b) === null ? -1 : sign * (value(a) - value(b)) || a.id - b.id,
    );
  };

  /** Match a row by number or range (5-12) of scenes, or else by a word in part names and tags. */
  function found(row, word) {
    const [, low, high] = word.match(/^(\d+)(?:-(\d+))?$/) ?? [];
    if (low !== undefined && row.id >= Number(low) && row.id <= Number(high ?? low)) return true;
    const names = Object.keys(row.objects).map((id) => Graycast.report.classes[id] ?? "");
    const texts = [...names, ...Graycast.tags.of(row.key), row.split, row.picture];
    return row.key === word || texts.some((text) => text.toLowerCase().includes(word));
  }

  /** Match by tag: "" all, "*" any tag, "-" no tag, "=name" this tag, "!name" not this tag. */
  function tagged(key) {
    const held = Graycast.tags.of(key),
      tag = filter.tag.slice(1);
    switch (filter.tag[0]) {
      case "*":
        return held.length > 0;
      case "-":
        return held.length === 0;
      case "=":
        return held.includes(tag);
      case "!":
        return !held.includes(tag);
      default:
        return true;
    }
  }

  /** Return the active filters: [description, names of the filters to remove]. */
  function narrowing() {
    const span = ([low, high]) => `${low} to ${high} %`,
      list = [];
    if (filter.find.trim()) list.push([`“${filter.find.trim()}”`, ["find"]]);
    if (filter.split) list.push([filter.split, ["split"]]);
    if (filter.object) list.push([Graycast.report.classes[filter.object], ["object"]]);
    if (filter.tag) list.push([tagWords(filter.tag), ["tag"]]);
    if (filter.found) list.push([Graycast.found.words(filter.found), ["found"]]);
    return [...list, ...spans().map((name) => [spanWords(name, span(filter[name])), [name]])];
  }

  const spans = () => ["visibility", "decoded", "share"].filter((name) => !whole(filter[name]));
  const spanWords = (name, text) =>
    `${{ visibility: "mean visibility", decoded: "decoded", share: words(filter.reason) }[name]} ${text}`;

  function tagWords(value) {
    const tag = value.slice(1);
    return { "*": "with a tag", "-": "without a tag", "=": `tag ${tag}`, "!": `not ${tag}` }[
      value[0]
    ];
  }

  // --- the controls -------------------------------------------------------------------------------

  /**
   * Make the two rows above the grid: {element, renew(), tell(rows)}. A change of a filter calls
   * `changed()`. `renew` draws the controls again; `tell` shows how many scenes remain.
   */
  Graycast.filterBar = (changed) => {
    const row = el("div", { class: "filter-row" }),
      told = el("span", { id: "told", role: "status" }),
      chips = el("span", { class: "chips" }),
      saving = el("button", { id: "save", onclick: () => Graycast.tags.save(savable()) }),
      message = el("span", { id: "message", role: "status" });
    const savable = () =>
      Graycast.tags.ticked.size ? Graycast.tags.ticked : Graycast.filtered().map((r) => r.key);
    const renew = () => row.replaceChildren(...controls(changed, lift).filter(Boolean));
    const lift = (names) => {
      const base = blank();
      for (const name of names) filter[name] = base[name];
      renew();
      changed();
    };
    const say = (text) => {
      message.textContent = text;
      renew();
      changed();
    };
    renew();
    const below = el(
      "div",
      { class: "told-row" },
      told,
      chips,
      message,
      el("span", { class: "spring" }),
      saving,
      loader(say),
    );
    const tell = (rows) => {
      const n = Graycast.tags.ticked.size || rows.length;
      told.textContent = `${Graycast.count(rows.length)} of ${Graycast.count(Graycast.rows().length)} scenes`;
      saving.textContent = `save ${Graycast.count(n)} ${Graycast.tags.ticked.size ? "ticked" : "shown"}`;
      saving.disabled = n === 0;
      saving.title =
        "Save these scenes and their tags as a file. Use the file with graycast dataset export --selection FILE.";
      chips.replaceChildren(
        ...narrowing().map(([text, names]) =>
          el(
            "span",
            { class: "chip" },
            text,
            el(
              "button",
              {
                title: "remove this filter",
                "aria-label": `remove the filter ${text}`,
                onclick: () => lift(names),
              },
              "×",
            ),
          ),
        ),
      );
      const count = spans().length;
      row.querySelector("summary").textContent = count ? `filters (${count})` : "filters";
    };
    return { element: el("div", { class: "filters" }, row, below), renew, tell, lift };
  };

  Graycast.liftAll = () => Object.keys(blank()).filter((name) => !KEPT.includes(name));

  function loader(say) {
    const file = el("input", {
      id: "load-file",
      type: "file",
      accept: ".json",
      hidden: true,
      onchange: async () => {
        const [one] = file.files;
        if (one) say(Graycast.tags.take(one.name, await one.text()));
        file.value = "";
      },
    });
    const title = "Load a file of scenes that this page saved, and add its tags.";
    return [file, el("button", { id: "load", title, onclick: () => file.click() }, "load")];
  }

  function controls(changed, lift) {
    const { statistics, classes } = Graycast.report;
    const set = (name) => (event) => {
      filter[name] = event.target.value;
      changed();
    };
    const select = (name, label, options) =>
      el(
        "select",
        { id: `pick-${name}`, "aria-label": label, title: label, onchange: set(name) },
        options.map(([value, text]) =>
          el("option", { value, selected: filter[name] === value }, text),
        ),
      );
    const splits = Object.keys(statistics.scenes);
    return [
      el("input", {
        id: "find",
        type: "search",
        value: filter.find,
        placeholder: "find: number, part, tag  ( / )",
        title:
          "A scene's number, a range such as 5-12, a part's name or a tag; all words must match.",
        "aria-label": "find scenes",
        oninput: set("find"),
      }),
      splits.length > 1
        ? select("split", "split", [["", "all splits"], ...splits.map((s) => [s, s])])
        : null,
      Object.keys(classes).length > 1
        ? select("object", "part", [["", "all parts"], ...Object.entries(classes)])
        : null,
      select("tag", "tag", tagChoices()),
      ...foundControls(changed, set, select),
      panel(changed, set, select),
      el("button", { id: "reset", onclick: () => lift(Object.keys(blank())) }, "reset"),
      el("span", { class: "spring" }),
      el("label", {}, "sort", select("sort", "sort by", SORTS)),
      el(
        "button",
        {
          id: "direction",
          title: "smallest or largest first",
          "aria-label": "smallest or largest first",
          onclick: (event) => {
            filter.down = !filter.down;
            event.target.textContent = filter.down ? "↓" : "↑";
            changed();
          },
        },
        filter.down ? "↓" : "↑",
      ),
      el("label", {}, el("span", { class: "long" }, "show"), select("thumb", "show", THUMBS)),
    ];
  }

  /** Filter scenes with missed or false detections; a scene opened from the grid shows only those. */
  function foundControls(changed, set, select) {
    if (!Graycast.report.detections) return [];
    const pick = select(
      "found",
      "what the detector missed or found wrongly",
      Graycast.found.FILTERS,
    );
    pick.addEventListener("change", () => Graycast.found.follow(filter.found));
    return [
      pick,
      Graycast.found.slider("least-score", Graycast.prefs, (value) => {
        Graycast.prefs.score = value;
        changed();
      }),
    ];
  }

  function tagChoices() {
    const known = Graycast.tags.all();
    const none = [
      ["", known.length ? "all tags" : "no tags yet"],
      ["*", "with a tag"],
      ["-", "without a tag"],
    ];
    const choices = [
      ...none.slice(0, known.length || filter.tag ? 3 : 1),
      ...known.map(([tag, n]) => [`=${tag}`, `${tag} (${n})`]),
      ...known.map(([tag]) => [`!${tag}`, `not ${tag}`]),
    ];
    if (!choices.some(([value]) => value === filter.tag)) filter.tag = ""; // No scene has this tag now.
    return choices;
  }

  /** Return the ranges of shares, behind one button. */
  function panel(changed, set, select) {
    const range = (name, label) =>
      el(
        "div",
        { class: "range" },
        label,
        ...[0, 1].map((end) =>
          el("input", {
            type: "number",
            min: 0,
            max: 100,
            step: 1,
            value: filter[name][end],
            id: `${name}-${end ? "to" : "from"}`,
            "aria-label": `${name} ${end ? "to" : "from"} %`,
            oninput: (event) => {
              const value = event.target.valueAsNumber;
              filter[name][end] = Number.isNaN(value) ? 100 * end : value;
              changed();
            },
          }),
        ),
        "%",
      );
    const reasons = Graycast.report.reasons
      .slice(1)
      .map((r) => [r.name, `reason: ${words(r.name)}`]);
    return el(
      "details",
      { id: "more" },
      el("summary", { title: "filter by shares of pixels" }, "filters"),
      el(
        "div",
        { class: "panel" },
        range("visibility", el("span", {}, "mean visibility of the parts")),
        range("decoded", el("span", {}, "decoded pixels of the parts")),
        range("share", select("reason", "pixels of the parts lost for this reason", reasons)),
      ),
    );
  }
  addEventListener("pointerdown", (event) => {
    const open = /** @type {HTMLDetailsElement} */ (document.querySelector("#more[open]"));
    if (open && !open.contains(/** @type {Node} */ (event.target))) open.open = false;
  });
}
