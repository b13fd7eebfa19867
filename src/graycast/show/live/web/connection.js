"use strict";
// Commands to the server, and its messages and answers.

{
  const { live } = Graycast,
    { at } = live,
    main = at("main");

  // --- commands to the server ---------------------------------------------------------------------

  const waiting = []; // commands that have not been sent
  let sending = false;

  /** Send a command after the waiting commands; of waiting drafts for a key, send only the last. */
  live.send = (command) => {
    const last = waiting.at(-1);
    if (command.draft && last?.draft && last.key === command.key) waiting.pop();
    waiting.push({ ...command, since: performance.now() });
    if (!sending) pass();
  };

  async function pass() {
    sending = true;
    while (waiting.length) {
      const { since, ...command } = waiting.shift();
      if (command.do !== "look") showError(""); // An error may arrive before the answer.
      try {
        const reply = await fetch("do", {
          method: "POST",
          headers: { "Content-Type": "application/json" },
          body: JSON.stringify(command),
        });
        const answer = await reply.json();
        if (answer.number)
          live.latencies.push({ number: answer.number, since, ms: null, change: null });
        if (answer.error) {
          showError(answer.error);
          live.showSettings(); // This resets the control to the present value.
        } else if (command.do === "rewrite" && at("text").value === command.text) {
          live.edited = false;
          live.showSettings();
        }
        if (answer.saved) at("doing").textContent = `saved: ${answer.saved}`;
      } catch {
        showError("graycast live has ended: start it again and reload this page");
      }
    }
    sending = false;
  }

  live.set = (key, value, draft) => live.send({ do: "set", key, value, draft });
  live.drag = (changes, draft) => {
    const keys = Object.keys(changes);
    keys.forEach((key, k) => live.set(key, changes[key], draft || k < keys.length - 1));
  };

  function showError(text) {
    if (text) live.errors.push(text);
    at("error").hidden = !text;
    at("error").textContent = text;
  }

  // --- messages from the server -------------------------------------------------------------------

  /** Listen to the server; the other scripts must have been loaded. */
  live.connect = () => {
    const stream = new EventSource("events");
    stream.onmessage = ({ data }) => receive(JSON.parse(data));
    stream.onerror = () => {
      main.dataset.ready = "";
      version = 0; // A restarted server counts versions from 0.
    };
  };

  function receive(message) {
    switch (message.kind) {
      case "state":
        live.state = message;
        main.dataset.asked = live.state.number;
        live.showSettings();
        break;
      case "stage":
        at("doing").textContent = `${message.stage} …`;
        showProgress(`Starting: ${message.stage} …`);
        break;
      case "error":
        if (message.number && message.number !== live.state?.number) break; // It concerns earlier settings.
        at("doing").textContent = "";
        main.dataset.failed = message.number ?? "";
        main.classList.add("stale"); // The picture has other settings.
        showError(message.error);
        showProgress("There is no picture of these settings: the message above says why.");
        break;
      default:
        fetchNewer();
    }
  }

  /** Show a text at the place of the first picture. */
  function showProgress(text) {
    const place = at("waiting");
    if (place) place.textContent = text;
  }

  let version = 0; // the newest version of the fetched answers
  let fetching = null;
  let again = false;

  /** Fetch newer answers, with one request at a time. */
  function fetchNewer() {
    if (fetching) {
      again = true;
      return;
    }
    fetching = fetchOnce().finally(() => {
      fetching = null;
      if (again) {
        again = false;
        fetchNewer();
      }
    });
  }

  async function fetchOnce() {
    const reply = await fetch(`newer?${version}`);
    if (!reply.ok) return;
    const buffer = await reply.arrayBuffer();
    const length = new DataView(buffer).getUint32(0, true);
    const pieces = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    for (const piece of pieces) version = Math.max(version, piece.version);
    const arraysOf = (piece) => (name, Type) => {
      const [from, bytes] = piece.arrays[name];
      return new Type(buffer, 4 + length + from, bytes / Type.BYTES_PER_ELEMENT);
    };
    for (const piece of pieces) if (piece.kind === "world") live.takeWorld(piece, arraysOf(piece));
    for (const piece of pieces)
      if (piece.kind === "picture") live.takePicture(piece, arraysOf(piece));
  }
}
