// Search in pages that are opened as files: browsers start no worker there, so a frame stands for one.
(function () {
  if (location.protocol !== "file:") return;

  class FrameWorker extends EventTarget {
    constructor(url) {
      super();
      const base = new URL(url, location.href);
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.documentElement.appendChild(frame);
      const inside = (this.inside = frame.contentWindow);
      inside.postMessage = (data) => setTimeout(() => this.dispatchEvent(new MessageEvent("message", { data })));
      inside.importScripts = (...urls) => urls.reduce((before, next) => before.then(() => load(next)), Promise.resolve());

      function load(source) {
        return new Promise((resolve, reject) => {
          const script = inside.document.createElement("script");
          script.src = new URL(source, base).href;
          script.onload = resolve;
          script.onerror = () => reject(new Error("cannot load " + source));
          inside.document.documentElement.appendChild(script);
        });
      }

      this.loaded = load(base);
    }

    postMessage(data) {
      this.loaded.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
    }
  }

  window.IFrameWorker = window.Worker = FrameWorker;
})();
