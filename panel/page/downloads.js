// Downloads of what the bench has recorded: it always records, and keeps the last 64 MiB.

import { button, el, greyed } from "./dom.js";

const FORMATS = [
  ["trace", "Trace", "what happened, for drivetwin replay"],
  ["vcd", "VCD", "waveforms of pins and motion, for GTKWave"],
  ["pcapng", "pcapng", "frames of the lines, for Wireshark"],
];

export function downloads(app, node) {
  const fetchIt = async (source, format) => {
    source.setAttribute("aria-busy", "true");
    const result = await app.backend.download(format);
    source.removeAttribute("aria-busy");
    if (!result.ok) return app.say(result.body?.detail ?? "The download failed.");
    const url = URL.createObjectURL(result.blob);
    el("a", { href: url, download: result.name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
  };
  const choices = FORMATS.map(([format, title, use]) =>
    button(title, { "data-download": format, title: `Download the recording: ${use}`, "aria-label": `${title}: download ${use}` }, event => fetchIt(event.currentTarget, format)));
  const group = el("div", { class: "segments", role: "group", "aria-label": "Download the recording" }, choices);
  node.append(el("span", { class: "hint" }, "Save"), group);
  return {
    update({ changes }) {
      if (changes.cannot !== undefined) greyed(node, app.cannot("trace"));
    },
  };
}
