// Downloads of what the bench has recorded: it always records, and keeps the last 64 MiB. The button marks a part.

import { attr, button, el, greyed, text } from "./dom.js";
import { clock } from "./format.js";
import { cut } from "./recording.js";

const FORMATS = [
  ["trace", "Trace", "what happened, for drivetwin replay"],
  ["vcd", "VCD", "waveforms of pins and motion, for GTKWave"],
  ["pcapng", "pcapng", "frames of the lines, for Wireshark"],
];

export function downloads(app, node) {
  let from = null, to = null; // bench time at which the marked part begins and ends, in seconds
  const now = () => app.store.state.time?.seconds ?? 0;

  const fetchIt = async (source, format) => {
    source.setAttribute("aria-busy", "true");
    const result = await app.backend.download(format);
    source.removeAttribute("aria-busy");
    if (!result.ok) return app.say(result.body?.detail ?? "The download failed.");
    const url = URL.createObjectURL(from === null ? result.blob : await cut(format, result.blob, from, to ?? now()));
    el("a", { href: url, download: result.name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
  };
  const dot = el("span", { class: "dot", "aria-hidden": "true" });
  const words = el("span", {});
  const record = button([dot, words], { "data-action": "record", class: "record" }, () => {
    if (from !== null && to === null) to = now();
    else [from, to] = [now(), null];
    show();
  });
  const forget = button("×", { class: "ghost", "data-action": "record-clear", "aria-label": "Forget the marked part: save all", title: "Save all again, not the part alone" }, () => {
    from = to = null;
    show();
    record.focus();
  });
  const choices = FORMATS.map(([format, title, use]) => button(title, { "data-download": format }, event => fetchIt(event.currentTarget, format)));
  const hint = el("span", { class: "hint" });
  node.append(record, forget, hint, el("div", { class: "segments", role: "group", "aria-label": "Download the recording" }, choices));

  const elapsed = () => {
    text(words, from === null ? "Record" : `${clock((to ?? now()) - from, 1)} s`);
    attr(record, "data-value", from === null ? null : (to ?? now()) - from);
  };
  const show = () => {
    const state = from === null ? "off" : to === null ? "on" : "done";
    attr(record, "data-state", state);
    attr(record, "aria-label", { off: "Record from now on", on: "Stop the recording", done: "Record again from now on" }[state]);
    attr(record, "title", { off: "Marks a part of what the bench records: from now until the next click", on: "Stop", done: "Record again from now on" }[state]);
    forget.hidden = from === null;
    text(hint, from === null ? "Save" : "Save part");
    FORMATS.forEach(([format, title, use], i) => {
      const part = from === null ? "" : format === "trace" ? "; whole, because a replay needs its beginning" : ", the part alone";
      attr(choices[i], "title", `Download the recording: ${use}${part}`);
      attr(choices[i], "aria-label", `${title}: download ${use}${part}`);
    });
    elapsed();
  };
  show();

  return {
    update({ changes, whole }) {
      if (changes.cannot !== undefined) greyed(node, app.cannot("trace"));
      if (whole && from !== null && now() < from) { // another bench
        from = to = null;
        app.say("The bench has started again: the part that was marked for saving is gone.");
        show();
      }
      if (changes.time && from !== null && to === null) elapsed();
    },
  };
}
