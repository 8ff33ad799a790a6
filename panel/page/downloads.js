// Downloads of what the bench has recorded.

import { button, el, greyed } from "./dom.js";

const FORMATS = [
  ["trace", "Trace", "what happened, for drivetwin replay"],
  ["vcd", "Waveforms", "VCD, for GTKWave"],
  ["pcapng", "Frames", "pcapng, for Wireshark"],
];

export function downloads(app, node) {
  const summary = el("summary", { class: "ghost" }, "Download");
  const choices = FORMATS.map(([format, title, use]) =>
    button([el("b", {}, title), el("span", {}, use)], { "data-download": format }, async event => {
      const source = event.currentTarget;
      source.setAttribute("aria-busy", "true");
      const result = await app.backend.download(format);
      source.removeAttribute("aria-busy");
      if (!result.ok) return app.say(result.body?.detail ?? "The download failed.");
      const url = URL.createObjectURL(result.blob);
      el("a", { href: url, download: result.name }).click();
      setTimeout(() => URL.revokeObjectURL(url), 60_000);
      menu.open = false;
    }));
  const body = el("div", { class: "menu-body" }, el("p", { class: "hint" }, "The bench always records; the last 64 MiB are kept."), ...choices);
  const menu = el("details", { class: "menu" }, summary, body);
  node.append(menu);
  document.addEventListener("click", event => {
    if (!menu.contains(event.target)) menu.open = false;
  });
  menu.addEventListener("keydown", event => {
    if (event.key === "Escape") {
      menu.open = false;
      summary.focus();
    }
  });
  return {
    update({ changes }) {
      if (changes.cannot !== undefined) greyed(body, app.cannot("trace"));
    },
  };
}
