// The program in the memory of a drive, with the line that is about to run.

import { attr, card, el, text } from "./dom.js";

export function programCard(app, kind) {
  const rows = new Map();
  const list = el("ol", { class: "program-lines" });
  const state = el("span", { class: "hint" });
  const empty = el("p", { class: "empty" }, "The memory of the drive has no program.");
  const node = card(kind.kind.startsWith("mdrive") ? "MCode program" : "User program", { class: "program", id: "program" }, el("div", { class: "tools" }, state), empty, list);
  let running = null;
  return {
    node,
    update({ changes, whole }) {
      const change = whole ? app.store.state.drive?.program : changes.drive?.program;
      const reason = app.cannot("program");
      if (change === undefined && !whole && !changes.cannot) return;
      const program = app.store.state.drive?.program;
      node.hidden = !program && !reason;
      text(empty, program || !reason ? "The memory of the drive has no program." : `The program is not shown: ${reason}.`);
      if (!program) return;
      if (whole || change?.lines) {
        rows.clear();
        list.replaceChildren(...program.lines.map(({ at, text: words }) => {
          const row = el("li", { "data-line": at }, el("span", { class: "address" }, at), el("code", {}, words));
          rows.set(at, row);
          return row;
        }));
        running = null;
      }
      empty.hidden = program.lines.length > 0;
      if (program.running !== running) {
        const earlier = rows.get(running), row = rows.get(program.running);
        if (earlier) attr(earlier, "aria-current", null);
        running = program.running;
        if (row) {
          attr(row, "aria-current", "step");
          const outside = row.offsetTop < list.scrollTop || row.offsetTop + row.offsetHeight > list.scrollTop + list.clientHeight;
          if (outside) list.scrollTop = row.offsetTop - list.clientHeight / 2;
        }
      }
      text(state, running === undefined || running === null ? "not running" : `running, line ${running}`);
    },
  };
}
