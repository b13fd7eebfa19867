"use strict";

// Browsers start no worker from a page that was opened from the disk, and the search runs in one.
// There, a hidden frame takes the worker's place: the script runs in its window, and messages are
// events. Pages of a server keep the browser's own workers.
(() => {
  if (location.protocol !== "file:") return;

  /** Runs a script in a hidden frame, and answers to the names of a worker. */
  class FrameWorker extends EventTarget {
    /** @param {string | URL} url the script */
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.documentElement.append(frame);
      /** @type {any} */
      const scope = frame.contentWindow;
      /** @param {any} data */
      scope.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      const script = scope.document.createElement("script");
      script.src = new URL(url, location.href).href;
      this.scope = scope;
      this.ready = new Promise((resolve) => script.addEventListener("load", resolve));
      scope.document.body.append(script);
    }

    /** @param {any} data the message to the script, which waits until the script runs */
    postMessage(data) {
      this.ready.then(() => this.scope.dispatchEvent(new MessageEvent("message", { data })));
    }
  }

  /** @type {any} */ (window).Worker = FrameWorker;
})();
